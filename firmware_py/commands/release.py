"""Torque off for every servo, whatever happened to the loop that switched it on."""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.config import read_config
from firmware_py.console import DONE, NEGATIVE, emit
from firmware_py.realtime.clock import DeadlineClock
from firmware_py.robot import open_bus
from firmware_py.safety.stop_reason import UNRELEASED

EXAMPLE = "dropstitch release --config robot.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--config", type=Path, required=True, metavar="ROBOT", help="robot.toml")


def run(args: argparse.Namespace) -> int:
    """Release the servos; the verdict is negative if one does not confirm it."""
    config = read_config(args.config)
    with open_bus(config, DeadlineClock()) as bus:
        released = bus.torque(False) is BusStatus.OK
    emit(
        args,
        {"released": released},
        "torque off" if released else UNRELEASED,
    )
    return DONE if released else NEGATIVE
