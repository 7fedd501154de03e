"""Torque off for every servo, whatever happened to the loop that switched it on.

Only the servos and their bus are read from robot.toml, so that no mistake elsewhere in it keeps a
torque on. If the file is no TOML, the lines of these two tables are read alone.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import re
import sys
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import check_models, model_named
from firmware_py.bus.servo_setup import ServoSetup, check_ids
from firmware_py.bus.transport import BAUD_RATES, open_transport
from firmware_py.core.console import DONE, NEGATIVE, emit
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import MOST_TOML_BYTES, convert, parse_toml, read_bytes
from firmware_py.core.signals import PERIOD_S
from firmware_py.safety.states import UNRELEASED
from firmware_py.system.clock import DeadlineClock

EXAMPLE = "dropstitch release --config robot.toml"


_TABLES: Final = ("bus", "servos")
_HEADER: Final = re.compile(r"\s*\[\[?\s*([\w-]+)\s*[].]")
"""Header of a table, up to the first part of its name."""


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
    data = read_bytes(path, "copy the commented robot.toml", MOST_TOML_BYTES)
    try:
        tables = parse_toml(path, data, tables=_TABLES)
    except InputError as error:
        tables = _parsed_alone(path, data, error)
    robot = convert(tables, DrivenRobot, path, "", "see the commented robot.toml for every key")
    if robot.bus.baud not in BAUD_RATES:
        offered = ", ".join(map(str, BAUD_RATES))
        raise InputError(path, f"bus.baud is {robot.bus.baud}", f"choose from {offered}")
    if not robot.servos:
        raise InputError(path, "servos has no entry", "give one per joint, 1 or 2")
    check_models([servo.model for servo in robot.servos], path)
    check_ids([servo.id for servo in robot.servos], path)
    return robot


def _parsed_alone(path: Path, data: bytes, error: InputError) -> dict[str, Any]:
    """Return bus and servos of a file that is no TOML, if their own lines are; else raise `error`.

    A table ends at the next line that begins with a bracket.
    """
    kept, lines = False, []
    for line in data.decode("utf-8-sig", errors="replace").split("\n"):
        if line.lstrip().startswith("["):
            header = _HEADER.match(line)
            kept = header is not None and header[1] in _TABLES
        if kept:
            lines.append(line)
    try:
        tables = parse_toml(path, "\n".join(lines).encode(), tables=_TABLES)
    except InputError:
        raise error from None
    if not all(name in tables for name in _TABLES):
        raise error
    print(
        f"dropstitch release: warning: {error} Only [bus] and [[servos]] are read, to release the "
        "servos all the same.",
        file=sys.stderr,
    )
    return tables
