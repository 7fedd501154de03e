"""Every kind of fault that can be injected: where it acts, and the function that does it.

| where | when | function of |
|---|---|---|
| reply | for each reply of a servo | frame, value, random numbers; returns what arrives instead |
| instruction | for each write to a single servo | never called: the write is lost |
| servo | at the first exchange and behind the last | servo, value, whether it begins |
| tick | in each tick, before the estimate | host, value |
| estimate | in each tick | host, value, estimate; returns another |
| predict | in each tick, before the prediction | host, value |
| prediction | in each tick | host, value, prediction; returns another |
| innovation | in each tick of a plan with feedback | host, value, innovation; returns another |
| clock | whenever the loop reads its clock | host, value; returns the step in ns |
| port | whenever the loop uses its port | host, value |
| read | for each read from the port | host, value, size; returns the bytes read |
| goals | for each goal of another program | host, value, latest message, goal; returns messages |
| process | once, while `dropstitch run` moves the robot | robot, value; returns when it began |
| bundle | once, before `dropstitch run` | directory; returns the keys that the robot trusts |

A function of a process returns the time in ns at which the fault began, unless that was at once. A
program that sends no messages but None is gone.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import msgspec
import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from firmware_py.goals.goal_channel import GoalMessage, encode_goal
from firmware_py.inference.bundle import PREDICTOR, read_manifest
from firmware_py.inference.bundle_signature import key_text
from firmware_py.inference.golden import GOLDEN, Golden, read_golden, write_golden
from firmware_py.inference.manifest import MANIFEST, manifest_bytes, write_manifest
from firmware_py.inference.predictor import Prediction
from hil.emulator.line_faults import REPLY_FAULTS, UNHEARD
from models.commands.sign import sign_bundle

if sys.platform != "win32":  # the module is imported there, see `firmware_py.core.console`
    import resource

Place = Literal[
    "reply", "instruction", "servo", "tick", "estimate", "predict", "prediction", "innovation",
    "clock", "port", "read", "goals", "process", "bundle",
]  # fmt: skip


class FaultKind(NamedTuple):
    where: Place
    act: Callable[..., Any]


class Host:
    """The robot's software, on which faults act; `take` spends a time in s on the run's clock."""

    def __init__(self, now_ns: Callable[[], int], take: Callable[[float], None]) -> None:
        self.now_ns, self.take = now_ns, take
        self.request_stop: Callable[[str], None] = lambda reason: None
        self.port_back_ns: float | None = None  # When the port is back; None if it never went

    def unplug(self, away_s: float) -> None:
        """Remove the port for a time, once."""
        if self.port_back_ns is None:
            self.port_back_ns = self.now_ns() + away_s * 1e9


@dataclass(frozen=True)
class RobotProcess:
    """A running `dropstitch run`, on which faults act."""

    pid: int
    bundle: Path
    log: Path
    unplug: Callable[[float], int]  # Removes the port for a time in s; returns when, in ns


# --- servo: `hil.faults.servo_log.LoggedServo`


def _at_begin(act: Callable[[Any, float], None]) -> FaultKind:
    return FaultKind("servo", lambda servo, value, begins: act(servo, value) if begins else None)


def _sensor(name: str) -> FaultKind:
    """Set an attribute of the servo to the value, and back to 0 when the fault ends."""
    return FaultKind("servo", lambda servo, value, begins: setattr(servo, name, value * begins))


# --- host: the robot's software

_GARBAGE_CYCLES: Final = 300
_FLOOD: Final = b"\xff\xff\xfd\x00\x01\xf0\x03\x55"
"""Header of a long status packet, the bytes that take a parser longest."""


def _take(host: Host, time_s: float) -> None:
    host.take(time_s)


def _litter(host: Host, value: float) -> None:
    """Create reference cycles, which only the garbage collector can free."""
    for _ in range(_GARBAGE_CYCLES):
        cycle: list[object] = []
        cycle.append(cycle)


def _wrong_tip(host: Host, tip_m: float, prediction: Prediction) -> Prediction:
    return Prediction(np.full(3, tip_m), np.zeros(1), np.zeros(3))


def _out_of_range(host: Host, value: float, prediction: Prediction) -> Prediction:
    return Prediction(prediction.tip_m, np.zeros(1), np.zeros(3))


def _flood(host: Host, bytes_per_s: float, size: int) -> bytes:
    host.take(size / bytes_per_s)
    return (_FLOOD * size)[:size]


# --- goals of another program: the messages that it sends

_BEYOND_M: Final = 1.5
"""Tip coordinate out of reach for an arm of 1 m."""
_STEP_RAD: Final = 0.2
"""Step of the goal in one tick of a program that is too fast: 12 rad/s."""
_FLOOD_MESSAGES: Final = 8


def _too_fast(host: Host, _: float, latest: bytes, goal: GoalMessage) -> list[bytes]:
    joint_rad = tuple(value + _STEP_RAD for value in goal.joint_rad or ())
    return [encode_goal(GoalMessage(goal.tick, joint_rad))]


def _beyond(host: Host, _: float, latest: bytes, goal: GoalMessage) -> list[bytes]:
    tip_m = (_BEYOND_M,) * len(goal.joint_rad or ())
    return [encode_goal(GoalMessage(goal.tick, None, tip_m))]


# --- processes: `dropstitch run` and its recorder


def recorders(pid: int) -> list[int]:
    """Recorder processes that are children of a process."""
    children = []
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((path / "stat").read_bytes().rpartition(b")")[2].split()[1])
            if parent == pid and b"firmware_py.log.recorder" in (path / "cmdline").read_bytes():
                children.append(int(path.name))
    return children


def _freeze(robot: RobotProcess, time_s: float) -> None:
    os.kill(robot.pid, signal.SIGSTOP)
    time.sleep(time_s)
    os.kill(robot.pid, signal.SIGCONT)


def _signal_recorder(robot: RobotProcess, number: float) -> None:
    for pid in recorders(robot.pid):
        os.kill(pid, int(number))


def _fill_disk(robot: RobotProcess, value: float) -> None:
    size = robot.log.stat().st_size
    for pid in recorders(robot.pid):
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, size))


def _swap_bundle(robot: RobotProcess, value: float) -> None:
    for path in robot.bundle.iterdir():
        path.write_bytes(b"swapped")


# --- bundle: damages that the robot must refuse before it switches the torque on

_OFF_M: Final = 1e-6
"""Error of the golden tip. Another processor or library explains only 1e-9 m."""


def _change_a_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def _changed_file(bundle: Path) -> tuple[str, ...]:
    _change_a_byte(bundle / PREDICTOR)
    return ()


def _change_files(bundle: Path, change: Callable[[dict[str, str]], dict[str, str]]) -> None:
    """Change the hashes by file name in the manifest."""
    manifest = read_manifest(bundle)
    manifest = msgspec.structs.replace(manifest, files=change(manifest.files))
    (bundle / MANIFEST).write_bytes(manifest_bytes(manifest))


def _unnamed_file(bundle: Path) -> tuple[str, ...]:
    """Remove the predictor from the manifest, then change it: no hash reveals the change."""
    _change_files(bundle, lambda files: {n: h for n, h in files.items() if n != PREDICTOR})
    _change_a_byte(bundle / PREDICTOR)
    return ()


def _file_outside(bundle: Path) -> tuple[str, ...]:
    _change_files(bundle, lambda files: files | {"../ticks.mcap": "0" * 64})
    return ()


def _golden(change: Callable[[Golden], Golden]) -> FaultKind:
    """Replace the golden ticks, with a manifest whose hashes match."""

    def replace(bundle: Path) -> tuple[str, ...]:
        manifest = read_manifest(bundle)
        write_golden(bundle / GOLDEN, change(read_golden(bundle / GOLDEN, manifest.dof)))
        write_manifest(bundle, manifest)
        return ()

    return FaultKind("bundle", replace)


def _new_public_key() -> str:
    return key_text(Ed25519PrivateKey.generate().public_key().public_bytes_raw())


def _unsigned(bundle: Path) -> tuple[str, ...]:
    return (_new_public_key(),)


def _foreign_signature(bundle: Path) -> tuple[str, ...]:
    sign_bundle(bundle, Ed25519PrivateKey.generate())
    return (_new_public_key(),)


def _changed_after_signature(bundle: Path) -> tuple[str, ...]:
    trusted = sign_bundle(bundle, Ed25519PrivateKey.generate())
    manifest = msgspec.structs.replace(read_manifest(bundle), training_data_sha256="0" * 64)
    (bundle / MANIFEST).write_bytes(msgspec.json.encode(manifest))
    return (trusted,)


FAULT_KINDS: Final[dict[str, FaultKind]] = {
    **{name: FaultKind("reply", change) for name, change in REPLY_FAULTS.items()},
    UNHEARD: FaultKind("instruction", lambda: None),
    "silent": FaultKind("servo", lambda servo, value, begins: servo.hush(begins)),
    "hardware error": _at_begin(lambda servo, bits: servo.fail(int(bits))),
    "reboot": _at_begin(lambda servo, value: servo.reboot()),
    "torque": _at_begin(lambda servo, value: servo.lose_torque()),
    "watchdog": _at_begin(lambda servo, value: servo.trip_watchdog()),
    "encoder": _sensor("angle_error_rad"),
    "current": _sensor("current_error_a"),
    "frozen": FaultKind("servo", lambda servo, value, begins: setattr(servo, "frozen", begins)),
    "stall": FaultKind("tick", _take),
    "request": FaultKind("tick", lambda host, value: host.request_stop("a request")),
    "garbage": FaultKind("tick", _litter),
    "estimator": FaultKind("estimate", lambda host, di, estimate: estimate._replace(di=di)),
    "slow predictor": FaultKind("predict", _take),
    "predictor": FaultKind("prediction", _wrong_tip),
    "range": FaultKind("prediction", _out_of_range),
    "innovation": FaultKind("innovation", lambda host, value_a, innovation_a: value_a),
    "clock": FaultKind("clock", lambda host, step_s: round(step_s * 1e9)),
    "port": FaultKind("port", lambda host, away_s: host.unplug(away_s)),
    "flood": FaultKind("read", _flood),
    "program silent": FaultKind("goals", lambda host, value, latest, goal: []),
    "program stuck": FaultKind("goals", lambda host, value, latest, goal: [latest]),
    "program malformed": FaultKind(
        "goals", lambda host, value, latest, goal: [encode_goal(goal)[:-1]]
    ),
    "program too fast": FaultKind("goals", _too_fast),
    "program out of reach": FaultKind("goals", _beyond),
    "program flooding": FaultKind(
        "goals", lambda host, value, latest, goal: [encode_goal(goal)] * _FLOOD_MESSAGES
    ),
    "program gone": FaultKind("goals", lambda host, value, latest, goal: None),
    "signal": FaultKind("process", lambda robot, number: os.kill(robot.pid, int(number))),
    "freeze": FaultKind("process", _freeze),
    "recorder signal": FaultKind("process", _signal_recorder),
    "disk full": FaultKind("process", _fill_disk),
    "bundle swapped": FaultKind("process", _swap_bundle),
    "unplug": FaultKind("process", lambda robot, away_s: robot.unplug(away_s)),
    "changed file": FaultKind("bundle", _changed_file),
    "unnamed file": FaultKind("bundle", _unnamed_file),
    "file outside": FaultKind("bundle", _file_outside),
    "other golden ticks": _golden(lambda golden: golden._replace(tip_m=golden.tip_m + _OFF_M)),
    "golden ticks at rest": _golden(
        lambda golden: golden._replace(angle_rad=0.0 * golden.angle_rad)
    ),
    "unsigned": FaultKind("bundle", _unsigned),
    "foreign signature": FaultKind("bundle", _foreign_signature),
    "changed after the signature": FaultKind("bundle", _changed_after_signature),
}
