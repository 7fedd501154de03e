"""Case with real processes: `dropstitch run` and its recorder are killed, stopped or unplugged.

The servos run in a separate process (`servo_process`) that outlives the robot. Cases that unplug
the port use a pseudo-terminal, which disappears like a USB adapter; the others use a socket.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import msgspec
import tomli_w

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.config import RobotConfig
from firmware_py.core.console import BAD_INPUT
from firmware_py.core.errors import InputError
from firmware_py.inference.bundle_signature import TrustConfig
from firmware_py.log.recording import read_recording
from firmware_py.system.clock import RealTimeOptions
from hil.faults.cases.case_robot import CaseRobot, case_config
from hil.faults.cases.damaged_bundle import BUNDLE_DAMAGES
from hil.faults.cases.servo_process import ServoProcess, ServoProcessTask
from hil.faults.fault_row import FaultRow, Setup
from hil.faults.injection import FaultSchedule
from hil.faults.observation import CaseObservation, CaseOutcome, Columns, observe_case
from hil.sil.processors import assign_processors, pinned_to

if sys.platform != "win32":  # is imported there, see `firmware_py.core.console`
    import resource

SECONDS: Final = 2.6
REPLUG_SECONDS: Final = 4.5
"""Duration of the motion when the port comes back, longer than `SECONDS` of the other cases."""
SETTLE_S: Final = 0.3
_START_TIMEOUT_S: Final = 30.0
_END_TIMEOUT_S: Final = 30.0
_STILL_S: Final = 0.3


def run_process(robot: CaseRobot, row: FaultRow, number: int, seed: int) -> CaseObservation:
    """Run one case with real processes; see `hil.faults.cases.virtual_case.run_virtual`."""
    setup = row.setup
    loop_cpu, other_cpus = assign_processors()
    with contextlib.ExitStack() as stack:
        scratch = Path(stack.enter_context(TemporaryDirectory(prefix="dropstitch-faults-")))
        stack.enter_context(pinned_to(other_cpus))
        kind = "pty" if setup.unplug_s is not None else "socket"
        task = ServoProcessTask(
            robot.fmu, robot.dof, row, number, seed, kind, scratch / "tty-a", max(other_cpus)
        )
        servo_process = stack.enter_context(contextlib.closing(ServoProcess(task)))
        bundle = Path(shutil.copytree(robot.bundle.directory, scratch / "bundle"))
        keys = BUNDLE_DAMAGES[setup.bundle_damage](bundle) if setup.bundle_damage else ()
        port = str(scratch / "tty-*") if setup.port_renamed else str(task.port)
        config = msgspec.structs.replace(
            case_config(robot, row, number, port if kind == "pty" else f"unix:{port}"),
            bundle=str(bundle), real_time=RealTimeOptions(cpu=loop_cpu),
            trust=TrustConfig(keys=keys),
        )  # fmt: skip
        seconds = REPLUG_SECONDS if setup.replug_s else SECONDS
        process = stack.enter_context(_robot(config, scratch, seconds))
        began_ns = None
        if row.must.ended != "refused":
            _await(servo_process, FaultSchedule((), seed).start, process)
            began_ns = _act(setup, process, servo_process, scratch, task.port)
        output, errors = _end(process, servo_process)
        time.sleep(SETTLE_S)
        servo_log = servo_process.stop()
        columns = _columns(scratch / "ticks.mcap")
        outcome = _outcome(process, output, errors, columns)
    slots = round(seconds / config.period_s)
    return observe_case(
        outcome, columns, servo_log, began_ns, slots, config.period_s,
        config.limits_in_force.rate_rad_s,
    )  # fmt: skip


@contextlib.contextmanager
def _robot(config: RobotConfig, scratch: Path, seconds: float) -> Iterator[subprocess.Popen[str]]:
    path = scratch / "robot.toml"
    document = _without_none(msgspec.to_builtins(config))
    path.write_text(tomli_w.dumps(document), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "dropstitch", "run", "--config", str(path), "--seconds",
         str(seconds), "--log", str(scratch / "ticks.mcap"), "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=_hear_hangups,
    )  # fmt: skip
    try:
        yield process
    finally:
        for pid in (*_recorders(process.pid), process.pid):
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


def _await(servo_process: ServoProcess, exchange: int, process: subprocess.Popen[str]) -> None:
    """Wait until the running robot has reached an exchange."""
    deadline_s = time.monotonic() + _START_TIMEOUT_S
    while servo_process.exchange < exchange:
        if process.poll() is not None or time.monotonic() > deadline_s:
            words = process.stderr.read() if process.poll() is not None and process.stderr else ""
            raise InputError("dropstitch run", f"did not get going ({words.strip()})", "run it")
        time.sleep(1e-3)


def _act(
    setup: Setup,
    process: subprocess.Popen[str],
    servo_process: ServoProcess,
    scratch: Path,
    port: Path,
) -> int:
    """Perform the actions of the set-up; return the time at which they began, in ns."""
    began_ns = time.monotonic_ns()
    for pid in _recorders(process.pid):
        if setup.disk_full:
            size = (scratch / "ticks.mcap").stat().st_size
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, size))
        if setup.recorder_signal is not None:
            os.kill(pid, setup.recorder_signal)
    if setup.bundle_swapped:
        for path in (scratch / "bundle").iterdir():
            path.write_bytes(b"swapped")
    if setup.freeze_s:
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(setup.freeze_s)
        os.kill(process.pid, signal.SIGCONT)
    if setup.unplug_s is not None:
        began_ns = servo_process.unplug()
        if setup.replug_s:
            time.sleep(setup.unplug_s)
            servo_process.plug(port.with_name("tty-b") if setup.port_renamed else port)
    if setup.signal is not None:
        os.kill(process.pid, setup.signal)
    return began_ns


def _recorders(pid: int) -> list[int]:
    """Recorder processes that are children of a process."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((path / "stat").read_bytes().rpartition(b")")[2].split()[1])
            if parent == pid and b"firmware_py.log.recorder" in (path / "cmdline").read_bytes():
                found.append(int(path.name))
    return found


def _end(process: subprocess.Popen[str], servo_process: ServoProcess) -> tuple[str, str]:
    """Wait for the robot to end; return its standard output and standard error.

    A stopped recorder is killed once the bus is silent, because the robot waits for it.
    """
    seen, since_s = servo_process.exchange, time.monotonic()
    deadline_s = since_s + _END_TIMEOUT_S
    while process.poll() is None and time.monotonic() < deadline_s:
        time.sleep(0.02)
        if servo_process.exchange != seen:
            seen, since_s = servo_process.exchange, time.monotonic()
        elif time.monotonic() - since_s > _STILL_S:
            for pid in _recorders(process.pid):
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


def _outcome(
    process: subprocess.Popen[str], output: str, errors: str, columns: Columns
) -> CaseOutcome:
    if not output:
        if process.returncode == BAD_INPUT:
            return CaseOutcome("refused", errors.strip())
        killed = process.returncode == -signal.SIGKILL
        return CaseOutcome("killed" if killed else f"exit {process.returncode}", "no last words")
    summary = json.loads(output)
    timing = summary["timing"]
    logged = len(columns.get("tick", ()))
    stale = sum(n for name, n in summary["bus_faults"].items() if not BusStatus[name.upper()].fresh)
    return CaseOutcome(
        summary["ended"], summary["reason"], summary["replugs"],
        telemetry_drops=summary["ticks"] - logged,
        misses={cause: count for cause, count in timing["causes"].items() if count},
        unlogged_stale=stale if logged < summary["ticks"] else 0,
        held_up_ticks=summary["held_up_ticks"],
    )  # fmt: skip
