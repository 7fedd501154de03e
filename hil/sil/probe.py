"""Probe on a processor: a process of high priority that records the lateness of its wake-ups.

It is pinned, has a higher priority than the rest of this program, and wakes every millisecond by
`clock_nanosleep`, as cyclictest of rt-tests does. Its lateness on the loop's processor is the
reference jitter of the machine. If it is milliseconds late, no process of this program could have
run on that processor. Its inner loop is `c/probe.c`.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from firmware_py.system.clock import RealTimeOptions, real_time
from firmware_py.system.timing import Nanoseconds, Percentiles
from hil.emulator.child_process import ChildProcess
from models.shared.c_compiler import compile_library

PROBE_PRIORITY: Final = 80
PROBE_PERIOD_NS: Final = 1_000_000
STALL_NS: Final = 500_000
"""Lateness of a probe above which its processor counts as stalled."""
_SOURCE: Final = Path(__file__).with_name("c") / "probe.c"
_ROWS: Final = 20_000
_COLUMNS: Final = 3
_NONE = np.zeros(0, np.int64)


class ReferenceJitter(Percentiles, frozen=True, kw_only=True):
    """Lateness of a process that does nothing but wake, on the loop's processor."""

    period_ns: int  # Period of the wake-ups
    above_the_loop: bool  # Whether the priority was above the loop's


@dataclass(frozen=True)
class ProbeRecord:
    """Wake-ups of a probe on one processor."""

    wake_ns: Nanoseconds = field(default_factory=_NONE.copy)  # (n,), wake-up times
    lateness_ns: Nanoseconds = field(default_factory=_NONE.copy)  # (n,), after the deadline
    # (n,), processor time since the previous wake-up of this program's processes (including the
    # probe) that may run on this processor, without the observed process
    own_ns: Nanoseconds = field(default_factory=_NONE.copy)
    # Whether the probe had its real-time priority. Otherwise it may have waited for this program
    # itself, and its lateness proves nothing.
    privileged: bool = True

    @property
    def proves(self) -> bool:
        """Whether a late wake-up proves that no process of this program could run."""
        return self.privileged and len(self.wake_ns) > 0

    def jitter(self) -> ReferenceJitter:
        return ReferenceJitter.of(
            self.lateness_ns, period_ns=PROBE_PERIOD_NS, above_the_loop=self.proves
        )

    def stall_ns(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Return the certain and the possible stall time of the processor within a window.

        A stall is certain from the probe's deadline to its late wake-up. It may have begun up to
        one period earlier, but not before the previous wake-up.
        """
        if not self.proves:
            return 0, 0
        first, last = np.searchsorted(self.wake_ns, (start_ns, end_ns + PROBE_PERIOD_NS))
        wake, lateness = self.wake_ns[first : last + 1], self.lateness_ns[first : last + 1]
        before = np.append(self.wake_ns[first - 1] if first else start_ns, wake[:-1])
        stalled = lateness >= STALL_NS
        ends, begins = np.minimum(wake, end_ns), wake - lateness
        earliest = np.maximum(begins - PROBE_PERIOD_NS, before)
        certain, possible = (
            np.maximum(ends - np.maximum(b, start_ns), 0)[stalled].sum() for b in (begins, earliest)
        )
        return int(certain), int(possible)

    def own_between_ns(self, start_ns: int, end_ns: int) -> int:
        """Return the processor time of this program that may fall into a window."""
        first, last = np.searchsorted(self.wake_ns, (start_ns, end_ns))
        return int(self.own_ns[first : last + 1].sum())


class Probe(ChildProcess[ProbeRecord]):
    """Probe on one processor, running from its creation until `stop`.

    `neighbours` are processes of this program that may run on the same processor, without the
    observed one.
    """

    def __init__(self, cpu: int, neighbours: Sequence[int] = ()) -> None:
        with TemporaryDirectory(prefix="dropstitch-probe-") as scratch:
            library = compile_library([_SOURCE], Path(scratch) / "probe.so")
            super().__init__(f"probe on processor {cpu}", _probe, library, cpu, tuple(neighbours))


def _probe(pipe: Connection, library: Path, cpu: int, neighbours: tuple[int, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C in the terminal stops the loop
    watch = ctypes.CDLL(str(library)).watch
    watch.restype = ctypes.c_int64
    accounts = [os.open(f"/proc/{pid}/schedstat", os.O_RDONLY) for pid in neighbours]
    accounts_c, state = (ctypes.c_int * len(accounts))(*accounts), (ctypes.c_int64 * 2)()
    chunks = []
    with real_time(RealTimeOptions(priority=PROBE_PRIORITY, cpu=cpu)):
        privileged = os.sched_getparam(0).sched_priority == PROBE_PRIORITY
        pipe.send("ready")
        filled = _ROWS
        while filled == _ROWS:
            rows = np.zeros((_ROWS, _COLUMNS), np.int64)
            filled = watch(
                pipe.fileno(), ctypes.c_int64(PROBE_PERIOD_NS), accounts_c, len(accounts), state,
                ctypes.c_void_p(rows.ctypes.data), ctypes.c_int64(_ROWS),
            )  # fmt: skip
            chunks.append(rows[:filled])
    with contextlib.suppress(BrokenPipeError):  # the parent may have ended
        wake, lateness, own = np.ascontiguousarray(np.concatenate(chunks).T)
        pipe.send(ProbeRecord(wake, lateness, own, privileged=privileged))
