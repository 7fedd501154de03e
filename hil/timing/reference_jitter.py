"""Reference jitter: lateness of wake-ups on the loop's processor, measured during the run.

The usual tool is cyclictest (rt-tests). If it is not installed, the probe of `hil.timing.probe`
replaces it: `clock_nanosleep` in a separate process.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.realtime.percentiles import FRACTIONS, Percentiles
from hil.timing.cpu_accounts import PROBE_PRIORITY, ProbeRecord

_HISTOGRAM_US: Final = 20_000
_PATIENCE_S: Final = 5.0


class ReferenceJitter(Percentiles, frozen=True, kw_only=True):
    """Lateness of a process that does nothing but wake, on the loop's processor."""

    period_ns: int  # Period of the wake-ups
    method: str  # Tool, priority and processor of the measurement
    above_the_loop: bool  # Whether the priority was above the loop's


class Cyclictest:
    """Running cyclictest, or none if it is not installed or not permitted.

    It wakes with the loop's period, so that both are exposed to the same stalls of the host.
    """

    def __init__(self, cpu: int, period_s: float, scratch: Path) -> None:
        self._period_us = round(period_s * 1e6)
        self._result = scratch / "cyclictest.json"
        self._process: subprocess.Popen[bytes] | None = None
        if (program := shutil.which("cyclictest")) is not None:
            self._process = subprocess.Popen(
                [
                    program, "--default-system", "--mlockall", "--quiet", "--threads=1",
                    f"--priority={PROBE_PRIORITY}", f"--affinity={cpu}",
                    f"--interval={self._period_us}", f"--histogram={_HISTOGRAM_US}",
                    f"--json={self._result}",
                ],
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                start_new_session=True,  # a Ctrl-C in the terminal is for the loop
            )  # fmt: skip

    def stop(self) -> ReferenceJitter | None:
        """End cyclictest and return its result; None if there is none."""
        self.close()
        try:
            thread = json.loads(self._result.read_text(encoding="utf-8"))["thread"]["0"]
        except (OSError, ValueError, KeyError):
            return None
        counts = {int(us): int(n) for us, n in thread["histogram"].items()}
        measured = histogram_percentiles(counts, int(thread["cycles"]), int(thread["max"]))
        return ReferenceJitter(
            **msgspec.structs.asdict(measured),
            period_ns=1000 * self._period_us,
            method=f"cyclictest at SCHED_FIFO {PROBE_PRIORITY} on the loop's processor",
            above_the_loop=True,
        )

    def close(self) -> None:
        """End cyclictest if it is still running."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def histogram_percentiles(counts: dict[int, int], cycles: int, max_us: int) -> Percentiles:
    """Return the percentiles of a histogram of wake-ups by lateness in µs.

    `counts` lacks the wake-ups beyond the histogram's end; their lateness is taken to be `max_us`.
    """
    found: dict[str, int] = {}
    seen, wanted = 0, dict(FRACTIONS)
    for us, count in sorted(counts.items()):
        seen += count
        for name in [name for name, fraction in wanted.items() if seen >= fraction * cycles]:
            found[name] = 1000 * us
            del wanted[name]
    found |= dict.fromkeys(wanted, 1000 * max_us)
    return Percentiles(n=cycles, **found, max_ns=1000 * max_us)


def probe_jitter(probe: ProbeRecord) -> ReferenceJitter:
    """Return the jitter that a probe measured."""
    return ReferenceJitter.of(
        probe.lateness_ns,
        period_ns=probe.period_ns,
        method="clock_nanosleep in a process of its own on the loop's processor",
        above_the_loop=probe.proves,
    )


@contextlib.contextmanager
def cyclictest(cpu: int, period_s: float, scratch: Path) -> Iterator[Cyclictest]:
    """Run cyclictest during the block."""
    running = Cyclictest(cpu, period_s, scratch)
    try:
        yield running
    finally:
        running.close()
