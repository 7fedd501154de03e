"""What the machine did beside the loop: accounts of its processors, and a load on request.

A `ProbeRecord` is what a probe (`hil.timing.probe`) saw of a processor; `Releases` is the record
that the emulator keeps of its replies.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import platform
import signal
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Nanoseconds = NDArray[np.int64]

PROBE_PRIORITY: Final = 80
PROBE_PERIOD_NS: Final = 5_000_000
STALL_NS: Final = 1_000_000
"""Lateness of a probe from which on the processor is taken to have stood still."""
_NONE = np.zeros(0, np.int64)
_SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True)
class ProbeRecord:
    """What was seen on one processor.

    Attributes
    ----------
    wake_ns, lateness_ns : ndarray, shape (n,)
        Of the probe: when it woke and how long after its deadline.
    ours_ns : ndarray, shape (n,)
        Processor time, since the wake-up before, of those processes of ours (the probe among them)
        that may run on this processor beside the one that is watched.
    period_ns : int
        Of the probe.
    privileged : bool
        Whether the probe had its priority. Without it, it may have been late behind ourselves,
        and proves nothing.
    """

    wake_ns: Nanoseconds = field(default_factory=_NONE.copy)
    lateness_ns: Nanoseconds = field(default_factory=_NONE.copy)
    ours_ns: Nanoseconds = field(default_factory=_NONE.copy)
    period_ns: int = PROBE_PERIOD_NS
    privileged: bool = True

    @property
    def proves(self) -> bool:
        """Whether a late wake-up is proof that nobody of ours could run."""
        return self.privileged and len(self.wake_ns) > 0

    def stall_ns(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Time within the window for which the processor stood still, in one stall or several.

        Returns
        -------
        (int, int)
            What is certain: from the probe's deadline to its wake-up; and what is possible: from
            its wake-up before, since when it saw nothing.
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

    def ours_between_ns(self, start_ns: int, end_ns: int) -> int:
        """Processor time of ours that may fall into the window."""
        first, last = np.searchsorted(self.wake_ns, (start_ns, end_ns))
        return int(self.ours_ns[first : last + 1].sum())


@dataclass(frozen=True)
class Releases:
    """How punctual the emulator was, one row per packet.

    Attributes
    ----------
    due_ns, written_ns : ndarray, shape (n,)
        When the bytes were due at the host's end and when they were written there.
    run_delay_ns : ndarray, shape (n,)
        Run-queue delay of the emulator since the packet before.
    """

    due_ns: Nanoseconds = field(default_factory=_NONE.copy)
    written_ns: Nanoseconds = field(default_factory=_NONE.copy)
    run_delay_ns: Nanoseconds = field(default_factory=_NONE.copy)

    def run_delay_between_ns(self, start_ns: int, end_ns: int) -> int:
        """Run-queue delay of the emulator that may fall into the window."""
        first, last = np.searchsorted(self.written_ns, (start_ns, end_ns))
        return int(self.run_delay_ns[first : last + 1].sum())


@contextlib.contextmanager
def cpu_load(count: int, cpus: set[int]) -> Iterator[None]:
    """Keep processors busy with `count` processes of normal priority."""
    processes = [_SPAWN.Process(target=_spin, args=(cpus,), daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.terminate()
            process.join()


def _spin(cpus: set[int]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.sched_setaffinity(0, cpus)
    block = np.random.default_rng(0).standard_normal((64, 64))
    while True:
        block = block @ block
        block /= np.abs(block).max()


def assign_processors() -> tuple[int, set[int]]:
    """Processor for the loop, and those for everything else (the same where there is only one)."""
    available = sorted(os.sched_getaffinity(0))
    return available[-1], set(available[:-1]) or set(available)


@contextlib.contextmanager
def pinned_to(cpus: set[int]) -> Iterator[None]:
    """Keep this process, and all that it starts, to some processors."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cpus)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def scheduling_policy() -> str:
    """Policy and priority of the calling thread, like "SCHED_FIFO 50"."""
    names = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO"}
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return f"{names.get(policy, policy)} {os.sched_getparam(0).sched_priority}"


def host_environment() -> dict[str, Any]:
    """Facts about this machine that a timing depends on."""

    def fact(path: str) -> str:
        try:
            return Path(path).read_text(encoding="ascii").strip()
        except OSError:
            return "unknown"

    return {
        "kernel": f"{platform.system()} {platform.release()} {platform.version()}",
        "machine": platform.machine(),
        "processors": os.cpu_count() or 0,
        "python": platform.python_version(),
        "clock_source": fact("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        "governor": fact("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        "load_average": fact("/proc/loadavg").rsplit(" ", 2)[0],
    }
