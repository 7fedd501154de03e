"""Processors of the machine: assignment, artificial load, scheduling policy and description."""

from __future__ import annotations

import contextlib
import os
import platform
import signal
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from hil.emulator.child_process import SPAWN


class HostEnvironment(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Description of the machine on which a timing was measured."""

    kernel: str  # System, release and version
    machine: str  # Architecture
    processors: int  # Number of processors
    python: str  # Version of Python
    clock_source: str  # Clock source of the kernel; "unknown" if it reports none
    governor: str  # Frequency governor; "unknown" if the kernel reports none
    load_average: str  # Load over 1, 5 and 15 minutes; "unknown" if the kernel reports none


@contextlib.contextmanager
def cpu_load(count: int, cpus: set[int]) -> Iterator[None]:
    """Keep processors busy with `count` processes during the block."""
    processes = [SPAWN.Process(target=_spin, args=(cpus,), daemon=True) for _ in range(count)]
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
    """Return the processor for the loop, and those for everything else (a single one is both)."""
    available = sorted(os.sched_getaffinity(0))
    return available[-1], set(available[:-1]) or set(available)


@contextlib.contextmanager
def pinned_to(cpus: set[int]) -> Iterator[None]:
    """Pin this process, and the processes that it starts, to some processors during the block."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cpus)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def scheduling_policy() -> str:
    """Return policy and priority of the calling thread, like "SCHED_FIFO 50"."""
    names = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO"}
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return f"{names.get(policy, policy)} {os.sched_getparam(0).sched_priority}"


def host_environment() -> HostEnvironment:
    def fact(path: str) -> str:
        try:
            return Path(path).read_text(encoding="ascii").strip()
        except OSError:
            return "unknown"

    return HostEnvironment(
        kernel=f"{platform.system()} {platform.release()} {platform.version()}",
        machine=platform.machine(),
        processors=os.cpu_count() or 0,
        python=platform.python_version(),
        clock_source=fact("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        governor=fact("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        load_average=fact("/proc/loadavg").rsplit(" ", 2)[0],
    )
