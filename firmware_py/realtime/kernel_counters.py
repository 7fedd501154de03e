"""Counters of the kernel for the loop's thread: run-queue delay and steal time."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from typing import Protocol

if sys.platform != "win32":  # the loop is imported there too, by what plans for it
    import resource

__all__ = ["Counters", "KernelCounters", "NoCounters"]


class Counters(Protocol):
    """Counters of the kernel for the loop's thread."""

    def run_delay_ns(self) -> int:
        """Return the time for which the thread was ready to run and did not."""
        ...

    def start_computing(self) -> None:
        """Note that the thread has no reason to sleep from now on."""
        ...

    def delays_ns(self) -> tuple[int, int]:
        """Return `run_delay_ns`, and the time in which the processor itself stood still.

        The latter counts from `start_computing` on.
        """
        ...


class NoCounters:
    """Counters for simulated time, in which nothing is preempted."""

    def run_delay_ns(self) -> int:
        """Return zero."""
        return 0

    def start_computing(self) -> None:
        """Do nothing."""

    def delays_ns(self) -> tuple[int, int]:
        """Return no time in which the processor stood still."""
        return self.run_delay_ns(), 0


class KernelCounters:
    """Counters of the kernel for the thread that creates this object.

    The file stays open, so that a reading is one system call of 1 µs. A counter that does not exist
    reads as zero.
    """

    def __init__(self) -> None:
        self._schedule = _open(f"/proc/self/task/{threading.get_native_id()}/schedstat")
        self._start = (0, 0, 0, -1)

    def run_delay_ns(self) -> int:
        """See `Counters.run_delay_ns`."""
        return self._ran_and_delayed_ns()[1]

    def start_computing(self) -> None:
        """See `Counters.start_computing`."""
        self._start = (time.monotonic_ns(), *self._ran_and_delayed_ns(), _sleeps())

    def delays_ns(self) -> tuple[int, int]:
        """See `Counters.delays_ns`.

        A thread that does not sleep runs, or waits for its turn, or its processor stands still: a
        hypervisor has taken it, and the kernel does not count that time as the thread's. Where the
        thread has slept, the time is its own.
        """
        start_ns, ran_ns, delayed_ns, sleeps = self._start
        now_ns, (ran_now_ns, delayed_now_ns) = time.monotonic_ns(), self._ran_and_delayed_ns()
        if self._schedule is None or _sleeps() != sleeps:
            return delayed_now_ns, 0
        away_ns = now_ns - start_ns - (ran_now_ns - ran_ns) - (delayed_now_ns - delayed_ns)
        return delayed_now_ns, max(away_ns, 0)

    def _ran_and_delayed_ns(self) -> tuple[int, int]:
        if self._schedule is None:
            return 0, 0
        ran, delayed, _ = os.pread(self._schedule, 64, 0).split()
        return int(ran), int(delayed)

    def close(self) -> None:
        """Close the file."""
        if self._schedule is not None:
            os.close(self._schedule)


def _sleeps() -> int:
    """Times that this thread has given up its processor."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw


def _open(path: str) -> int | None:
    with contextlib.suppress(OSError):
        return os.open(path, os.O_RDONLY)
    return None
