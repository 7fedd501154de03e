"""Emulated servos with faults in a separate process, whose port can be unplugged.

The process outlives the robot, so its record covers the time after the robot was killed.
"""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from firmware_py.system.clock import RealTimeOptions, real_time
from firmware_py.system.kernel_counters import KernelCounters
from hil.emulator.emulator import PRIORITY
from hil.emulator.fmu_physics import FmuPhysics
from hil.emulator.line import Line, pty_endpoint, serve_line, socket_endpoint
from hil.faults.case_robot import case_servos
from hil.faults.fault_row import FaultRow
from hil.faults.faulty_parts import FaultSchedule
from hil.faults.servo_log import LoggedBus, LoggedServo, ServoLog

_SPAWN: Final = multiprocessing.get_context("spawn")


@dataclass(frozen=True)
class ServoProcessTask:
    """Specification of the servos of a case."""

    fmu: Path  # Twin FMU behind the servos
    dof: int
    row: FaultRow
    number: int  # Model number of the servos
    seed: int  # Seed of the fault's time and bits
    kind: str  # "socket" or "pty"
    port: Path  # Path of the socket, or of a link to the pseudo-terminal
    cpu: int  # Processor to which the process is pinned


@contextlib.contextmanager
def _plugged(
    task: ServoProcessTask, port: Path, stop_fd: int
) -> Iterator[Callable[[], int | None]]:
    """Open the port under a name; leaving the block unplugs it."""
    if task.kind == "socket":
        with socket_endpoint(port, stop_fd) as (_, connect):
            yield connect
        return
    with pty_endpoint() as (name, connect):
        port.symlink_to(name)
        try:
            yield connect
        finally:
            port.unlink()


class _CountedScript(FaultSchedule):
    """Fault schedule whose progress another process can read."""

    counter: Any

    def begin_exchange(self, servos: Sequence[LoggedServo], now_ns: int) -> None:
        super().begin_exchange(servos, now_ns)
        self.counter.value = self.exchange


def _run(pipe: Connection, counter: Any, task: ServoProcessTask) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    script = _CountedScript(task.row.injections, task.seed)
    script.counter = counter
    servos = case_servos(task.dof, task.row, task.number)
    bus = LoggedBus(servos, FmuPhysics(task.fmu, task.dof), script)
    line = Line(bus, task.row.setup.latency_s, script)
    bus.resume(time.monotonic_ns())
    port: Path | None = task.port
    gc.freeze()
    counters = KernelCounters()

    def note(due_ns: int, written_ns: int) -> None:
        bus.note_release(due_ns, written_ns, counters.run_delay_ns())

    with real_time(RealTimeOptions(priority=PRIORITY, cpu=task.cpu)):
        pipe.send(os.getpid())
        while port is not None:
            with _plugged(task, port, pipe.fileno()) as connect:
                while (fd := connect()) is not None:
                    if not serve_line(line, fd, pipe.fileno(), note):
                        break
            command = pipe.recv()
            while command == "unplug":
                pipe.send(time.monotonic_ns())
                while not pipe.poll(0.01):
                    bus.advance(time.monotonic_ns())
                command = pipe.recv()
            port = command
    pipe.send(bus.log(time.monotonic_ns()))


class ServoProcess:
    """Process that runs the servos of a case."""

    def __init__(self, task: ServoProcessTask) -> None:
        self._pipe, child_end = _SPAWN.Pipe()
        self._counter: Any = _SPAWN.RawValue("q", 0)
        self._process = _SPAWN.Process(
            target=_run, args=(child_end, self._counter, task), daemon=True
        )
        self._process.start()
        child_end.close()
        self.pid: int = self._receive()

    @property
    def exchange(self) -> int:
        """Number of exchanges of the running robot so far."""
        return int(self._counter.value)

    def _receive(self) -> Any:
        return self._pipe.recv()

    def unplug(self) -> int:
        """Remove the port; return the time in ns."""
        self._pipe.send("unplug")
        return int(self._receive())

    def plug(self, port: Path) -> None:
        """Open the port again, under a name."""
        self._pipe.send(port)

    def stop(self) -> ServoLog:
        """End the process and return the servos' record."""
        self._pipe.send(None)
        servo_log: ServoLog = self._receive()
        return servo_log

    def close(self) -> None:
        """End the process if it is still running."""
        self._pipe.close()
        self._process.join()
