"""Settings of a servo that the plant assumes: direction, zero and gains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import msgspec

from firmware_py.bus.registers import Register

__all__ = ["DRIVE_REVERSE", "GAINS", "AssumedSettings", "ServoGains"]

DRIVE_REVERSE: Final = 1
"""Bit of the register Drive Mode: positions count in reverse. The other bits, time-based profiles
and torque on by a goal, must be zero (docs/sources.md, "Control tables")."""


class ServoGains(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Gains with which the plant was identified (`gains` in `[[servos]]`), as register values."""

    position_p: int | None = None  # Register value; None skips the comparison
    position_i: int | None = None
    position_d: int | None = None
    velocity_p: int | None = None
    velocity_i: int | None = None

    def registers(self) -> dict[Register, int]:
        given = {register: getattr(self, name) for name, register in GAINS.items()}
        return {register: raw for register, raw in given.items() if raw is not None}


GAINS: Final = {
    "position_p": Register.POSITION_P_GAIN,
    "position_i": Register.POSITION_I_GAIN,
    "position_d": Register.POSITION_D_GAIN,
    "velocity_p": Register.VELOCITY_P_GAIN,
    "velocity_i": Register.VELOCITY_I_GAIN,
}
"""Register of each gain in `ServoGains`."""


class AssumedSettings(NamedTuple):
    """Settings that the plant assumes of a servo; a run refuses others."""

    reverse: bool = False  # Whether its positions count in reverse
    homing_offset_rad: float = 0.0  # Angle that the servo adds to its encoder
    gains: Mapping[Register, int] = {}
