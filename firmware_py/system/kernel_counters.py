"""Counters of the kernel for the loop's thread: run-queue delay and steal time."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time

if sys.platform != "win32":  # Windows imports the loop for planning
    import resource


class Counters:
    """Counters for the loop's thread; these read zero, for simulated time."""

    def run_delay_ns(self) -> int:
        """Return the run-queue delay: the time in which the thread was ready but did not run."""
        return 0

    def start_computing(self) -> None:
        """Mark the time from which on the thread does not sleep voluntarily."""

    def delays_ns(self) -> tuple[int, int]:
        """Return `run_delay_ns`, and the steal time of the processor since `start_computing`."""
        return self.run_delay_ns(), 0


class KernelCounters(Counters):
    """Counters of the kernel for the thread that creates this object.

    The file stays open, so that a reading is one system call of 1 µs. A missing counter reads zero.
    """

    def __init__(self) -> None:
        self._schedule = _open(f"/proc/self/task/{threading.get_native_id()}/schedstat")
        self._start = (0, 0, 0, -1)

    def run_delay_ns(self) -> int:
        return self._ran_and_delayed_ns()[1]

    def start_computing(self) -> None:
        self._start = (time.monotonic_ns(), *self._ran_and_delayed_ns(), _sleeps())

    def delays_ns(self) -> tuple[int, int]:
        """Return run-queue delay and steal time.

        A thread that does not sleep is running, is waiting in the run queue, or has lost its
        processor to the hypervisor, which the kernel counts as neither. If the thread has slept,
        this difference is not defined, and the steal time is zero.
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
        if self._schedule is not None:
            os.close(self._schedule)


def _sleeps() -> int:
    """Return the number of voluntary context switches of this thread."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw


def _open(path: str) -> int | None:
    with contextlib.suppress(OSError):
        return os.open(path, os.O_RDONLY)
    return None
