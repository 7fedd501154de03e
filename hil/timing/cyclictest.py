"""How late this machine wakes anybody: cyclictest on the loop's processor, in the same minutes.

cyclictest (rt-tests) is what the real-time community measures with. Where it is not installed the
probe of `hil.timing.cpu_accounts` takes its place: `clock_nanosleep` in a process of its own.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from hil.timing.cpu_accounts import PROBE_PRIORITY

_HISTOGRAM_US: Final = 20_000
_PATIENCE_S: Final = 5.0
_SHARES: Final = {"p50_ns": 0.5, "p99_ns": 0.99, "p99_9_ns": 0.999}


class Cyclictest:
    """A running cyclictest, or none where it is not installed or may not run.

    Parameters
    ----------
    cpu : int
        Processor to pin it to.
    period_s : float
        How often it wakes: as often as the loop, so that both meet the same stalls of the host.
    scratch : Path
        Directory for its result.
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

    def stop(self) -> dict[str, Any] | None:
        """End it; return count, percentiles, maximum and method, or None where it gave nothing."""
        self.close()
        try:
            thread = json.loads(self._result.read_text(encoding="utf-8"))["thread"]["0"]
        except (OSError, ValueError, KeyError):
            return None
        counts = {int(us): int(n) for us, n in thread["histogram"].items()}
        return {
            **histogram_percentiles(counts, int(thread["cycles"]), int(thread["max"])),
            "period_ns": 1000 * self._period_us,
            "method": f"cyclictest at SCHED_FIFO {PROBE_PRIORITY} on the loop's processor",
            "above_the_loop": True,
        }

    def close(self) -> None:
        """End it if it still runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def histogram_percentiles(counts: dict[int, int], cycles: int, max_us: int) -> dict[str, int]:
    """Percentiles of a histogram in µs, which may lack what lies beyond its end."""
    summary, seen, wanted = {"n": cycles}, 0, dict(_SHARES)
    for us, count in sorted(counts.items()):
        seen += count
        for name in [name for name, share in wanted.items() if seen >= share * cycles]:
            summary[name] = 1000 * us
            del wanted[name]
    return {**summary, **dict.fromkeys(wanted, 1000 * max_us), "max_ns": 1000 * max_us}


@contextlib.contextmanager
def cyclictest(cpu: int, period_s: float, scratch: Path) -> Iterator[Cyclictest]:
    """Run one as long as the block lasts."""
    running = Cyclictest(cpu, period_s, scratch)
    try:
        yield running
    finally:
        running.close()
