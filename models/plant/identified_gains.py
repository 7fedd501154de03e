"""Gains that the servos had in the trials of an identification, from a log or robot.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec

from firmware_py.bus.servo_settings import GAINS, ServoGains
from firmware_py.config import read_config
from firmware_py.errors import InputError
from firmware_py.log.recording import read_recording

__all__ = ["read_servo_gains"]

_LOG_SUFFIX: Final = ".mcap"


def read_servo_gains(path: Path) -> tuple[ServoGains, ...]:
    """Read the gains of each servo, in joint order.

    `path` is robot.toml or a log of `dropstitch run`, which records the gains read from the servos.
    """
    if path.suffix == _LOG_SUFFIX:
        gains = _found(path)
    else:
        gains = tuple(servo.gains or ServoGains() for servo in read_config(path).servos)
    if not gains or not all(one.registers() for one in gains):
        raise InputError(
            path, "does not give the gains of every servo",
            "name a log of this release, or add gains to each [[servos]]",
        )  # fmt: skip
    return gains


def _found(path: Path) -> tuple[ServoGains, ...]:
    text = read_recording(path).metadata.get("servo_settings", "[]")
    try:
        servos = msgspec.json.decode(text, type=list[dict[str, int]])
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"holds damaged settings ({error})", "name another log") from None
    return tuple(
        ServoGains(**{name: found.get(register.value) for name, register in GAINS.items()})
        for found in servos
    )
