"""Reference jitter: lateness of wake-ups on the loop's processor, measured beside the run.

cyclictest (rt-tests) is the usual tool for it. Where it is not installed, the probe of
`hil.timing.probe` takes its place: `clock_nanosleep` in a process of its own.
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

    period_ns: int  # How often it wakes
    method: str  # How it was measured
    above_the_loop: bool  # Whether its priority was above the loop's


class Cyclictest:
    """Running cyclictest, or none where it is not installed or may not run.

    `period_s`: how often it wakes: as often as the loop, so that both meet the same stalls of the
    host.
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
        """End it and return its result; None where it gave none."""
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
        """End it if it still runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def histogram_percentiles(counts: dict[int, int], cycles: int, max_us: int) -> Percentiles:
    """Return the percentiles of a histogram in µs.

    `counts`: wake-ups by lateness in µs; those beyond its end are left out.
    `max_us`: largest lateness, which also stands for those beyond the histogram's end.
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
    """Run one for as long as the block lasts."""
    running = Cyclictest(cpu, period_s, scratch)
    try:
        yield running
    finally:
        running.close()
