"""Probe on a processor: a process of high priority that records the lateness of its wake-ups.

It is pinned, has a higher priority than the rest of this program, and wakes every millisecond.
Its lateness is the reference jitter of the machine. If it is milliseconds late, no process of this
program could have run on that processor. Its inner loop is `c/probe.c`.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from firmware_py.system.clock import RealTimeOptions, real_time
from hil.sil.cpu_accounts import PROBE_PERIOD_NS, PROBE_PRIORITY, Nanoseconds, ProbeRecord
from models.shared.c_compiler import compile_library

__all__ = ["Probe"]

_SOURCE: Final = Path(__file__).with_name("c") / "probe.c"
_ROWS: Final = 20_000
_COLUMNS: Final = 3
_SPAWN = multiprocessing.get_context("spawn")


class Probe:
    """Probe on one processor, running from its creation until `stop`.

    `neighbours` are processes of this program that may run on the same processor, without the
    observed one.
    """

    def __init__(self, cpu: int, neighbours: Sequence[int] = ()) -> None:
        self._pipe, child_end = _SPAWN.Pipe()
        with TemporaryDirectory(prefix="dropstitch-probe-") as scratch:
            library = compile_library([_SOURCE], Path(scratch) / "probe.so")
            self._process = _SPAWN.Process(
                target=_probe, args=(child_end, library, cpu, tuple(neighbours)), daemon=True
            )
            self._process.start()
            child_end.close()
            self._privileged: bool = self._pipe.recv()

    def stop(self) -> ProbeRecord:
        """End the probe and return its record."""
        self._pipe.send(None)
        rows: Nanoseconds = self._pipe.recv()
        wake, lateness, own = np.ascontiguousarray(rows.T)
        return ProbeRecord(wake, lateness, own, privileged=self._privileged)

    def close(self) -> None:
        """End the probe if it is still running."""
        self._pipe.close()
        self._process.join()


def _probe(pipe: Connection, library: Path, cpu: int, neighbours: tuple[int, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C in the terminal stops the loop
    watch = ctypes.CDLL(str(library)).watch
    watch.restype = ctypes.c_int64
    accounts = [os.open(f"/proc/{pid}/schedstat", os.O_RDONLY) for pid in neighbours]
    accounts_c, state = (ctypes.c_int * len(accounts))(*accounts), (ctypes.c_int64 * 2)()
    chunks = []
    with real_time(RealTimeOptions(priority=PROBE_PRIORITY, cpu=cpu)):
        pipe.send(os.sched_getparam(0).sched_priority == PROBE_PRIORITY)
        filled = _ROWS
        while filled == _ROWS:
            rows = np.zeros((_ROWS, _COLUMNS), np.int64)
            filled = watch(
                pipe.fileno(), ctypes.c_int64(PROBE_PERIOD_NS), accounts_c, len(accounts), state,
                ctypes.c_void_p(rows.ctypes.data), ctypes.c_int64(_ROWS),
            )  # fmt: skip
            chunks.append(rows[:filled])
    with contextlib.suppress(BrokenPipeError):  # the parent may have ended
        pipe.send(np.concatenate(chunks))
