"""Accounts of the processors during a run: probe wake-ups and replies of the emulator.

A `ProbeRecord` is what a probe (`hil.timing.probe`) saw of a processor; `Releases` is the record
that the emulator keeps of its replies.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

Nanoseconds = NDArray[np.int64]

PROBE_PRIORITY: Final = 80
PROBE_PERIOD_NS: Final = 1_000_000
STALL_NS: Final = 500_000
"""Lateness of a probe from which on the processor is taken to have stood still."""
_NONE = np.zeros(0, np.int64)


@dataclass(frozen=True)
class ProbeRecord:
    """Wake-ups of a probe on one processor."""

    # (n,), of the probe: when it woke and how long after its deadline
    wake_ns: Nanoseconds = field(default_factory=_NONE.copy)
    lateness_ns: Nanoseconds = field(default_factory=_NONE.copy)
    # (n,), processor time, since the wake-up before, of those processes of this program (the probe
    # among them) that may run on this processor beside the one that is observed
    own_ns: Nanoseconds = field(default_factory=_NONE.copy)
    period_ns: int = PROBE_PERIOD_NS
    # Whether the probe had its priority. Without it, it may have waited behind this program, and
    # proves nothing.
    privileged: bool = True

    @property
    def proves(self) -> bool:
        """Whether a late wake-up proves that no process of this program could run."""
        return self.privileged and len(self.wake_ns) > 0

    def stall_ns(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Time within a window for which the processor stood still, in one stall or several.

        Returns what is certain: from the probe's deadline to its wake-up; and what is possible:
        from its wake-up before, since when it saw nothing.
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
        """Processor time of this program that may fall into a window."""
        first, last = np.searchsorted(self.wake_ns, (start_ns, end_ns))
        return int(self.own_ns[first : last + 1].sum())


@dataclass(frozen=True)
class Releases:
    """Punctuality of the emulator, one row per packet."""

    # (n,), when the bytes were due at the host's end and when they were written there
    due_ns: Nanoseconds = field(default_factory=_NONE.copy)
    written_ns: Nanoseconds = field(default_factory=_NONE.copy)
    # (n,), run-queue delay of the emulator since the packet before
    run_delay_ns: Nanoseconds = field(default_factory=_NONE.copy)

    def run_delay_between_ns(self, start_ns: int, end_ns: int) -> int:
        """Run-queue delay of the emulator that may fall into a window."""
        first, last = np.searchsorted(self.written_ns, (start_ns, end_ns))
        return int(self.run_delay_ns[first : last + 1].sum())
