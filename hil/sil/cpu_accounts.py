"""Account of a processor during a run: the wake-ups of a probe on it (`hil.sil.probe`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

Nanoseconds = NDArray[np.int64]

PROBE_PRIORITY: Final = 80
PROBE_PERIOD_NS: Final = 1_000_000
STALL_NS: Final = 500_000
"""Lateness of a probe above which its processor counts as stalled."""
_NONE = np.zeros(0, np.int64)


@dataclass(frozen=True)
class ProbeRecord:
    """Wake-ups of a probe on one processor."""

    wake_ns: Nanoseconds = field(default_factory=_NONE.copy)  # (n,), wake-up times
    lateness_ns: Nanoseconds = field(default_factory=_NONE.copy)  # (n,), after the deadline
    # (n,), processor time since the previous wake-up of this program's processes (including the
    # probe) that may run on this processor, without the observed process
    own_ns: Nanoseconds = field(default_factory=_NONE.copy)
    period_ns: int = PROBE_PERIOD_NS
    # Whether the probe had its real-time priority. Otherwise it may have waited for this program
    # itself, and its lateness proves nothing.
    privileged: bool = True

    @property
    def proves(self) -> bool:
        """Whether a late wake-up proves that no process of this program could run."""
        return self.privileged and len(self.wake_ns) > 0

    def stall_ns(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Return the certain and the possible stall time of the processor within a window.

        A stall is certain from the probe's deadline to its late wake-up. It may have begun up to
        one period earlier, but not before the previous wake-up.
        """
        if not self.proves:
            return 0, 0
        first, last = np.searchsorted(self.wake_ns, (start_ns, end_ns + self.period_ns))
        wake, lateness = self.wake_ns[first : last + 1], self.lateness_ns[first : last + 1]
        before = np.append(self.wake_ns[first - 1] if first else start_ns, wake[:-1])
        stalled = lateness >= STALL_NS
        ends, begins = np.minimum(wake, end_ns), wake - lateness
        earliest = np.maximum(begins - self.period_ns, before)
        certain, possible = (
            np.maximum(ends - np.maximum(b, start_ns), 0)[stalled].sum() for b in (begins, earliest)
        )
        return int(certain), int(possible)

    def own_between_ns(self, start_ns: int, end_ns: int) -> int:
        """Return the processor time of this program that may fall into a window."""
        first, last = np.searchsorted(self.wake_ns, (start_ns, end_ns))
        return int(self.own_ns[first : last + 1].sum())
