"""Clocks of the loop, real and simulated, and real-time scheduling of its thread.

Waiting for absolute deadlines keeps the phase: 600 ticks of 17 ms drift by 3 ms in total, compared
with 1.3–2.1 s with relative sleeping (docs/sources.md, "Fixed-rate loop"). On a busy machine
`SCHED_FIFO` has the largest effect. It is set inside the loop's thread, because a policy for the
whole service would promote every other thread as well.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Protocol

import msgspec

if sys.platform != "win32":  # Windows uses `SimClock`
    import resource

_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_CAP_IPC_LOCK: Final = 14
"""Number of the capability in capabilities(7)."""


class Clock(Protocol):
    """Clock of loop, port and emulated line."""

    def now_ns(self) -> int: ...

    def sleep_until(self, deadline_ns: int) -> None:
        """Wait until a deadline; return at once if it has passed."""
        ...


class DeadlineClock:
    """Monotonic clock of the machine."""

    now_ns = staticmethod(time.monotonic_ns)

    def sleep_until(self, deadline_ns: int) -> None:
        """Sleep until an absolute time (`time.sleep` uses `clock_nanosleep` since Python 3.11)."""
        while (remaining_ns := deadline_ns - time.monotonic_ns()) > 0:
            time.sleep(remaining_ns * 1e-9)


class SimClock:
    """Simulated clock, whose time advances only by waiting, so that a run is deterministic."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until(self, deadline_ns: int) -> None:
        """Advance to `deadline_ns`; do nothing if that has passed."""
        self._now_ns = max(self._now_ns, deadline_ns)

    def advance(self, duration_ns: int) -> None:
        """Advance by the duration of a computation or a transmission."""
        self._now_ns += duration_ns


class RealTimeOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Requests to the kernel (table `[real_time]` of robot.toml)."""

    # SCHED_FIFO priority of the loop's thread, 1–99; 0 keeps the normal scheduler
    priority: int = 50
    lock_memory: bool = True  # Keep all memory of the process in RAM
    freeze_gc: bool = True  # Collect garbage once, then disable the collector during the loop
    cpu: int | None = None  # Processor to pin the loop's thread to; None does not pin it


@contextlib.contextmanager
def real_time(options: RealTimeOptions) -> Iterator[list[str]]:
    """Make the calling thread real-time as far as the kernel permits; restore it afterwards.

    Yields the refused requests with remedies, one sentence each; empty if all were granted.
    """
    refused: list[str] = []
    affinity, collecting = os.sched_getaffinity(0), gc.isenabled()
    libc = ctypes.CDLL(None, use_errno=True)
    slack_ns = libc.prctl(_PR_GET_TIMERSLACK, 0, 0, 0, 0)
    libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)  # 1 ns; effective under the normal scheduler only
    if options.freeze_gc:
        gc.collect()
        gc.freeze()
        gc.disable()
    if options.lock_memory and not _lock_memory(libc):
        refused.append("memory is not locked; raise 'ulimit -l' or run the installed service")
    if options.cpu is not None:
        try:
            os.sched_setaffinity(0, {options.cpu})
        except OSError:
            refused.append(f"processor {options.cpu} is not available; correct real_time.cpu")
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    if options.priority > 0:
        try:
            os.sched_setscheduler(
                0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(options.priority)
            )
        except OSError:
            refused.append("SCHED_FIFO is refused; grant CAP_SYS_NICE or run the installed service")
    try:
        yield refused
    finally:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, policy, parameters)
        with contextlib.suppress(OSError):  # a processor may be gone
            os.sched_setaffinity(0, affinity)
        libc.prctl(_PR_SET_TIMERSLACK, slack_ns, 0, 0, 0)
        if options.lock_memory:
            libc.munlockall()
        if options.freeze_gc:
            gc.unfreeze()
            if collecting:
                gc.enable()


def may_lock_memory() -> bool:
    """Whether the kernel lets this process lock all its memory, present and future.

    Under a finite limit MCL_FUTURE would make a later allocation fail. The limit does not bind a
    process with CAP_IPC_LOCK (mlock(2)).
    """
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return soft == resource.RLIM_INFINITY or _has_capability(_CAP_IPC_LOCK)


def _has_capability(number: int) -> bool:
    """Whether the effective set has a capability; without /proc, whether the user is root."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return os.geteuid() == 0
    effective = status.partition("CapEff:")[2].split()
    return bool(effective) and bool(int(effective[0], 16) >> number & 1)


def _lock_memory(libc: ctypes.CDLL) -> bool:
    return may_lock_memory() and bool(libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0)
