"""Cases in real time: the servos run in another process, which outlives the robot.

On the line "socket" the loop runs in this process. On the line "process" `dropstitch run` and its
recorder are real processes, which are killed, stopped or unplugged. Cases that unplug the port use
a pseudo-terminal, which disappears like a USB adapter.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import msgspec
import tomli_w

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.transport import Transport, open_transport
from firmware_py.config import RobotConfig
from firmware_py.core.console import BAD_INPUT
from firmware_py.core.errors import InputError
from firmware_py.goals.goal_source import GoalTable
from firmware_py.inference.bundle_signature import TrustConfig
from firmware_py.log.recording import read_recording
from firmware_py.system.clock import DeadlineClock, RealTimeOptions, real_time
from firmware_py.system.kernel_counters import KernelCounters
from hil.emulator.child_process import SPAWN, ChildProcess
from hil.emulator.emulator import PRIORITY
from hil.emulator.line import Line, pty_endpoint, serve_line, socket_endpoint
from hil.emulator.physics import FmuPhysics
from hil.faults.case_robot import CaseRobot, case_config, case_servos, run_case_loop
from hil.faults.fault_kinds import RobotProcess, recorders
from hil.faults.fault_row import FaultRow
from hil.faults.faulty_parts import FaultSchedule, HostFaults
from hil.faults.observation import CaseObservation, Columns, observe_case
from hil.faults.servo_log import LoggedBus, ServoLog
from hil.sil.processors import assign_processors, pinned_to

SOCKET_SLOTS: Final = 150
"""Slots of the motion on a socket: 2.6 s. The fault begins before the 110th."""
PROCESS_S: Final = 2.6
REPLUG_S: Final = 4.5
"""Duration of the motion of a process whose port comes back; of the others: `PROCESS_S`."""
_SETTLE_S: Final = 0.3
_START_TIMEOUT_S: Final = 30.0
_END_TIMEOUT_S: Final = 30.0
_STILL_S: Final = 0.3


# --- the servos in another process


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


def _run_servos(pipe: Connection, exchange: Any, task: ServoProcessTask) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    script = FaultSchedule(task.row.injections, task.seed)
    servos = case_servos(task.dof, task.row, task.number)
    bus = LoggedBus(servos, FmuPhysics(task.fmu, task.dof), script)
    line = Line(bus, task.row.setup.latency_s, script)
    bus.resume(time.monotonic_ns())
    port: Path | None = task.port
    gc.freeze()
    counters = KernelCounters()

    def note(due_ns: int, written_ns: int) -> None:
        bus.note_release(due_ns, written_ns, counters.run_delay_ns())
        exchange.value = script.exchange

    with real_time(RealTimeOptions(priority=PRIORITY, cpu=task.cpu)):
        pipe.send("ready")
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


class ServoProcess(ChildProcess[ServoLog]):
    """Process that runs the servos of a case."""

    def __init__(self, task: ServoProcessTask) -> None:
        self._counter: Any = SPAWN.RawValue("q", 0)
        super().__init__("servos of the case", _run_servos, self._counter, task)

    @property
    def exchange(self) -> int:
        """Number of exchanges of the running robot so far."""
        return int(self._counter.value)

    def unplug(self) -> int:
        """Remove the port; return the time in ns."""
        return int(self.ask("unplug"))

    def plug(self, port: Path) -> None:
        """Open the port again, under a name."""
        self.tell(port)


@contextlib.contextmanager
def _servos(
    robot: CaseRobot, row: FaultRow, number: int, seed: int, kind: str
) -> Iterator[tuple[Path, ServoProcess, ServoProcessTask, int]]:
    """Start the servos of a case; yield a scratch directory, them, and the loop's processor."""
    loop_cpu, other_cpus = assign_processors()
    with TemporaryDirectory(prefix="dropstitch-faults-") as scratch, pinned_to(other_cpus):
        task = ServoProcessTask(
            robot.fmu, robot.dof, row, number, seed, kind, Path(scratch) / "tty-a", max(other_cpus)
        )
        with contextlib.closing(ServoProcess(task)) as servos:
            yield Path(scratch), servos, task, loop_cpu


# --- the loop in this process


def run_socket(robot: CaseRobot, row: FaultRow, number: int, seed: int) -> CaseObservation:
    """Run one case in real time; see `hil.faults.virtual_case.run_virtual`."""
    clock = DeadlineClock()
    with _servos(robot, row, number, seed, "socket") as (_, servos, task, loop_cpu):
        config = case_config(robot, row, number, f"unix:{task.port}")
        config = msgspec.structs.replace(config, real_time=RealTimeOptions(cpu=loop_cpu))
        host = HostFaults(FaultSchedule(row.injections, seed), clock.now_ns, time.sleep)
        goals = GoalTable(config.goals_rad(repeated=True))

        def opener() -> Transport:
            return open_transport(config.bus.port, config.bus.baud, clock)

        with contextlib.closing(KernelCounters()) as counters, real_time(config.real_time):
            before = _collections()
            reported, columns = run_case_loop(
                robot, config, (goals, None), SOCKET_SLOTS, clock, host, opener, counters
            )
            collections = _collections() - before
        servo_log = servos.stop()
    if collections:
        reported = msgspec.structs.replace(
            reported, ended="collected", reason=f"{collections} garbage collections"
        )
    began_ns = (host.began_ns, servo_log.began_ns)
    return observe_case(reported, columns, servo_log, began_ns, SOCKET_SLOTS, config)


def _collections() -> int:
    return sum(int(generation["collections"]) for generation in gc.get_stats())


# --- the robot as a process


def run_process(robot: CaseRobot, row: FaultRow, number: int, seed: int) -> CaseObservation:
    """Run one case with real processes; see `hil.faults.virtual_case.run_virtual`."""
    setup = row.setup
    kind = "pty" if any(i.kind == "unplug" for i in row.injections) else "socket"
    with _servos(robot, row, number, seed, kind) as (scratch, servos, task, loop_cpu):
        bundle = Path(shutil.copytree(robot.bundle.directory, scratch / "bundle"))
        log = scratch / "ticks.mcap"
        script = FaultSchedule(row.injections, seed)
        began_ns, keys = None, ()
        for injection in script.of("bundle"):
            began_ns = began_ns or time.monotonic_ns()
            keys = injection.does.act(bundle)
        port = str(scratch / "tty-*") if setup.port_renamed else str(task.port)
        config = msgspec.structs.replace(
            case_config(robot, row, number, port if kind == "pty" else f"unix:{port}"),
            bundle=str(bundle), real_time=RealTimeOptions(cpu=loop_cpu),
            trust=TrustConfig(keys=keys),
        )  # fmt: skip
        seconds = REPLUG_S if setup.replug_s else PROCESS_S

        def unplug(away_s: float) -> int:
            gone_ns = servos.unplug()
            if setup.replug_s:
                time.sleep(away_s)
                servos.plug(scratch / "tty-b" if setup.port_renamed else task.port)
            return gone_ns

        with _robot(config, scratch / "robot.toml", log, seconds) as process:
            if actions := script.of("process"):
                _await(servos, script.start, process)
                began_ns = time.monotonic_ns()
                target = RobotProcess(process.pid, bundle, log, unplug)
                for injection in actions:
                    began_ns = injection.does.act(target, injection.value) or began_ns
            output, errors = _end(process, servos)
            time.sleep(_SETTLE_S)
            servo_log = servos.stop()
            columns = _columns(log)
            reported = _reported(process, output, errors, columns)
    slots = round(seconds / config.period_s)
    return observe_case(reported, columns, servo_log, [began_ns], slots, config)


@contextlib.contextmanager
def _robot(
    config: RobotConfig, path: Path, log: Path, seconds: float
) -> Iterator[subprocess.Popen[str]]:
    path.write_text(tomli_w.dumps(_without_none(msgspec.to_builtins(config))), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "dropstitch", "run", "--config", str(path), "--seconds",
         str(seconds), "--log", str(log), "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=_hear_hangups,
    )  # fmt: skip
    try:
        yield process
    finally:
        for pid in (*recorders(process.pid), process.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.communicate()


def _hear_hangups() -> None:
    """Handle SIGHUP by default: under `nohup` the robot would inherit that it is ignored."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value


def _await(servos: ServoProcess, exchange: int, process: subprocess.Popen[str]) -> None:
    """Wait until the running robot has reached an exchange."""
    deadline_s = time.monotonic() + _START_TIMEOUT_S
    while servos.exchange < exchange:
        if process.poll() is not None or time.monotonic() > deadline_s:
            words = process.stderr.read() if process.poll() is not None and process.stderr else ""
            raise InputError("dropstitch run", f"did not get going ({words.strip()})", "run it")
        time.sleep(1e-3)


def _end(process: subprocess.Popen[str], servos: ServoProcess) -> tuple[str, str]:
    """Wait for the robot to end; return its standard output and standard error.

    A stopped recorder is killed once the bus is silent, because the robot waits for it.
    """
    exchange, since_s = servos.exchange, time.monotonic()
    deadline_s = since_s + _END_TIMEOUT_S
    while process.poll() is None and time.monotonic() < deadline_s:
        time.sleep(0.02)
        if servos.exchange != exchange:
            exchange, since_s = servos.exchange, time.monotonic()
        elif time.monotonic() - since_s > _STILL_S:
            for pid in recorders(process.pid):
                if _stopped(pid):
                    os.kill(pid, signal.SIGKILL)
    return process.communicate(timeout=_END_TIMEOUT_S)


def _stopped(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0] == b"T"
    return False


def _columns(log: Path) -> Columns:
    """Ticks in the log, after a short wait for a recorder that is still writing."""
    deadline_s = time.monotonic() + 1.0
    while True:
        try:
            recording = read_recording(log)
        except InputError:
            return {}
        if recording.complete or time.monotonic() > deadline_s:
            return recording.columns
        time.sleep(0.05)


def _reported(
    process: subprocess.Popen[str], output: str, errors: str, columns: Columns
) -> CaseObservation:
    if not output:
        if process.returncode == BAD_INPUT:
            return CaseObservation("refused", errors.strip())
        killed = process.returncode == -signal.SIGKILL
        ended = "killed" if killed else f"exit {process.returncode}"
        return CaseObservation(ended, "no last words")
    summary = json.loads(output)
    misses = {cause: count for cause, count in summary["timing"]["causes"].items() if count}
    unlogged = summary["ticks"] - len(columns.get("tick", ()))
    stale = sum(n for name, n in summary["bus_faults"].items() if not BusStatus[name.upper()].fresh)
    return CaseObservation(
        summary["ended"],
        summary["reason"],
        replugs=summary["replugs"],
        unlogged_ticks=unlogged,
        lost_ticks=stale + sum(misses.values()) if unlogged > 0 else 0,
        misses=misses,
        held_up_ticks=summary["held_up_ticks"],
    )
