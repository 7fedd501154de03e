"""Torque off for every servo, whatever happened to the loop that switched it on.

Only the servos and their bus are read from robot.toml, so that no mistake elsewhere in it keeps a
torque on.
"""

from __future__ import annotations

import argparse
import contextlib
import math
from pathlib import Path

import msgspec

from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import model_named
from firmware_py.bus.servo_setup import ServoSetup, check_ids
from firmware_py.bus.transport import BAUD_RATES, open_transport
from firmware_py.core.console import DONE, NEGATIVE, emit
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_toml
from firmware_py.core.signals import PERIOD_S
from firmware_py.safety.states import UNRELEASED
from firmware_py.system.clock import DeadlineClock

EXAMPLE = "dropstitch release --config robot.toml"


class DrivenServo(msgspec.Struct, frozen=True):
    """What a release needs of `[[servos]]`."""

    id: int
    model: str


class DrivenBus(msgspec.Struct, frozen=True):
    """What a release needs of `[bus]`."""

    port: str
    baud: int = 1_000_000


class DrivenRobot(msgspec.Struct, frozen=True):
    """What a release needs of robot.toml."""

    bus: DrivenBus
    servos: tuple[DrivenServo, ...]


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=Path, required=True, metavar="ROBOT", help="robot.toml")


def run(args: argparse.Namespace) -> int:
    """Release the servos; the verdict is negative if one does not confirm it."""
    robot = read_driven_robot(args.config)
    port, baud, clock = robot.bus.port, robot.bus.baud, DeadlineClock()
    servos = [ServoSetup(s.id, model_named(s.model), -math.pi, math.pi) for s in robot.servos]
    transport = open_transport(port, baud, clock)
    bus = DynamixelBus(transport, servos, clock, period_s=PERIOD_S, name=port, baud=baud)
    with contextlib.closing(bus):
        released = bus.torque(False) is BusStatus.OK
    emit(args, {"released": released}, "torque off" if released else UNRELEASED)
    return DONE if released else NEGATIVE


def read_driven_robot(path: Path) -> DrivenRobot:
    tables = read_toml(path, "copy the commented robot.toml", tables=("bus", "servos"))
    robot = convert(tables, DrivenRobot, path, "", "see the commented robot.toml for every key")
    if robot.bus.baud not in BAUD_RATES:
        offered = ", ".join(map(str, BAUD_RATES))
        raise InputError(path, f"bus.baud is {robot.bus.baud}", f"choose from {offered}")
    if not robot.servos:
        raise InputError(path, "servos has no entry", "give one per joint, 1 or 2")
    check_ids([servo.id for servo in robot.servos], path)
    return robot
