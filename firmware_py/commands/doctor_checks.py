"""Doctor checks: settings of this PC that harm the loop's timing, with remedies.

Measured effects (docs/sources.md, "Fixed-rate loop"): the USB latency timer costs up to 16 ms of
17, the normal scheduler up to 43 ms under load, paging and the garbage collector hundreds; the rest
is smaller.
"""

from __future__ import annotations

import contextlib
import os
import platform
import sys
import threading
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.core.errors import InputError
from firmware_py.log.recording import require_packages
from firmware_py.system.clock import may_lock_memory

if sys.platform != "win32":  # --help works on Windows
    import resource

_GOOD_CLOCKS: Final = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page")
_LATENCY_LIMIT_MS: Final = 1
_TEST_PRIORITY: Final = 50


class Severity(Enum):
    """Effect of a finding on the timing."""

    GOOD = "good"
    NOTE = "note"
    """Not ideal, or unknown on this PC; the loop runs well enough."""
    SPOILS = "spoils"
    """Deadlines will be missed."""
    UNCHECKED = "not checked"
    """The subject of the check is absent, or this kernel does not report it."""


class Finding(NamedTuple):
    name: str
    verdict: Severity  # Effect on the timing
    found: str
    remedy: str = ""  # Empty if the setting is good


def examine(
    root: Path = Path("/"), may_be_real_time: Callable[[], bool] | None = None
) -> list[Finding]:
    """Run every check.

    `may_be_real_time`: returns whether SCHED_FIFO is granted; by default a thread tries it.
    """
    return [
        _latency_timer(root),
        _scheduler(may_be_real_time or try_fifo),
        _locked_memory(),
        _swap(root),
        _governor(root),
        _clock_source(root),
        _preemption(root),
        _python(),
        _recorder(),
    ]


def _read(path: Path) -> str | None:
    with contextlib.suppress(OSError):
        return path.read_text(encoding="utf-8").strip()
    return None


def _latency_timer(root: Path) -> Finding:
    name = "USB latency timer"
    files = sorted(root.glob("sys/bus/usb-serial/devices/*/latency_timer"))
    slow = {
        file.parent.name: int(text)
        for file in files
        if (text := _read(file)) and int(text) > _LATENCY_LIMIT_MS
    }
    if slow:
        timers = ", ".join(f"{device} {value} ms" for device, value in slow.items())
        return Finding(
            name, Severity.SPOILS, timers,
            "run 'dropstitch install-service' for a udev rule, or at once: "
            f"echo 1 | sudo tee /sys/bus/usb-serial/devices/{next(iter(slow))}/latency_timer",
        )  # fmt: skip
    if not files:
        return Finding(name, Severity.UNCHECKED, "no USB serial adapter is plugged in",
                       "plug it in and repeat the check")  # fmt: skip
    return Finding(name, Severity.GOOD, f"at most {_LATENCY_LIMIT_MS} ms")


def try_fifo() -> bool:
    """Return whether a thread may use SCHED_FIFO, by trying it in a short-lived thread."""
    granted = []

    def attempt() -> None:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_TEST_PRIORITY))
            granted.append(True)

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return bool(granted)


def _scheduler(may_be_real_time: Callable[[], bool]) -> Finding:
    if may_be_real_time():
        return Finding("scheduler rights", Severity.GOOD, "SCHED_FIFO is granted")
    return Finding(
        "scheduler rights", Severity.SPOILS, "SCHED_FIFO is refused",
        "run 'dropstitch install-service', or add '@realtime - rtprio 99' to "
        "/etc/security/limits.conf and yourself to that group",
    )  # fmt: skip


def _locked_memory() -> Finding:
    if may_lock_memory():
        return Finding("locked memory", Severity.GOOD, "unlimited")
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return Finding(
        "locked memory", Severity.NOTE, f"limited to {soft // 1024} KiB, so it will not be locked",
        "run 'dropstitch install-service', or add '@realtime - memlock unlimited' to "
        "/etc/security/limits.conf",
    )  # fmt: skip


def _swap(root: Path) -> Finding:
    text = _read(root / "proc/swaps")
    if text is None:
        return Finding("swap", Severity.UNCHECKED, "/proc/swaps cannot be read", "mount /proc")
    lines = text.splitlines()[1:]
    if not lines:
        return Finding("swap", Severity.GOOD, "off")
    return Finding("swap", Severity.NOTE, f"on ({lines[0].split()[0]})",
                   "sudo swapoff -a, if memory cannot be locked")  # fmt: skip


def _governor(root: Path) -> Finding:
    files = root.glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    governors = {text for file in files if (text := _read(file))}
    if not governors:
        return Finding(
            "frequency governor", Severity.UNCHECKED, "this kernel shows none",
            "on a virtual machine look at its host; else load the processor's cpufreq driver",
        )  # fmt: skip
    if governors == {"performance"}:
        return Finding("frequency governor", Severity.GOOD, "performance")
    return Finding(
        "frequency governor", Severity.NOTE, ", ".join(sorted(governors)),
        "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
    )  # fmt: skip


def _clock_source(root: Path) -> Finding:
    folder = root / "sys/devices/system/clocksource/clocksource0"
    current = _read(folder / "current_clocksource")
    if current is None:
        return Finding(
            "clock source", Severity.UNCHECKED, "this kernel does not show it", "mount /sys"
        )
    if current in _GOOD_CLOCKS:
        return Finding("clock source", Severity.GOOD, current)
    return Finding(
        "clock source", Severity.SPOILS, f"{current}, slow to read and coarse",
        f"boot with clocksource=tsc (available: {_read(folder / 'available_clocksource')})",
    )  # fmt: skip


def _preemption(root: Path) -> Finding:
    version = _read(root / "proc/version") or platform.version()
    if _read(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in version:
        return Finding("kernel preemption", Severity.GOOD, "PREEMPT_RT")
    if "PREEMPT" in version:
        return Finding("kernel preemption", Severity.GOOD, "preemptible, enough for 17 ms")
    return Finding("kernel preemption", Severity.NOTE, "none",
                   "boot with preempt=full, or install a PREEMPT_RT kernel")  # fmt: skip


def _python() -> Finding:
    # From 3.11 on, the oldest supported version, time.sleep waits until an absolute time.
    return Finding("Python", Severity.GOOD, platform.python_version())


def _recorder() -> Finding:
    try:
        require_packages()
    except InputError as error:
        return Finding("recorder", Severity.NOTE, error.what, error.remedy)
    return Finding("recorder", Severity.GOOD, "mcap and lz4 are installed")
