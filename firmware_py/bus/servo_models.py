"""Servo models, and the conversion between raw register values and SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from firmware_py.bus.registers import (
    LEGACY_PRO,
    PRO_P,
    X_SERIES,
    ControlTable,
    Indirect,
    Register,
    RegisterField,
)
from firmware_py.core.errors import InputError

__all__ = ["MODELS", "Model", "model_named"]


def round_half_away(value: float) -> int:
    """Return the nearest integer, halves away from zero.

    The rounding is symmetric about zero, so goals of +x and −x give opposite pulses. Python's own
    rounds halves to even.
    """
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    magnitude = math.floor(abs(value))
    if abs(value) - magnitude >= 0.5:  # exact; adding 0.5 first could round up 0.49999…
        magnitude += 1
    return -magnitude if value < 0 else magnitude


@dataclass(frozen=True)
class Model:
    """Servo model: control table, and conversion of raw register values to SI units.

    Attributes
    ----------
    number : int
        Value of the register Model Number, which identifies the servo.
    name : str
        Name on the type plate.
    table : ControlTable
        Registers of the servo's family.
    pulses_per_turn : int
        Pulses per turn of the output shaft.
    zero_pulse : int
        Raw position at zero angle: 0 for PRO and P, whose positions are signed; 2048 for X.
    current_a_per_lsb, velocity_rad_s_per_lsb : float
        Resolution of current in A and velocity in rad/s (docs/sources.md, "Control tables").
    """

    number: int
    name: str
    table: ControlTable
    pulses_per_turn: int
    zero_pulse: int
    current_a_per_lsb: float
    velocity_rad_s_per_lsb: float

    @cached_property
    def rad_per_pulse(self) -> float:
        """Resolution of the position, in rad per pulse."""
        return 2.0 * math.pi / self.pulses_per_turn

    def angle_rad(self, raw: int) -> float:
        """Return the angle of a raw position, in rad."""
        return (raw - self.zero_pulse) * self.rad_per_pulse

    def position_raw(self, angle_rad: float) -> int:
        """Return the raw position nearest to an angle.

        Parameters
        ----------
        angle_rad : float
            Angle of the output shaft in rad, zero where the link is upright.

        Raises
        ------
        ValueError
            If the angle is not finite or does not fit the register.
        """
        raw = self.zero_pulse + round_half_away(angle_rad / self.rad_per_pulse)
        return _checked(raw, self.table[Register.GOAL_POSITION], "angle", angle_rad, "rad")

    def current_a(self, raw: int) -> float:
        """Return the current of a raw value, in A."""
        return raw * self.current_a_per_lsb

    def current_raw(self, current_a: float) -> int:
        """Return the raw value nearest to a current; raises as `position_raw`."""
        raw = round_half_away(current_a / self.current_a_per_lsb)
        return _checked(raw, self.table[Register.PRESENT_CURRENT], "current", current_a, "A")

    def velocity_rad_s(self, raw: int) -> float:
        """Return the angular velocity of a raw value, in rad/s."""
        return raw * self.velocity_rad_s_per_lsb

    def velocity_raw(self, velocity_rad_s: float) -> int:
        """Return the raw value nearest to an angular velocity; raises as `position_raw`."""
        raw = round_half_away(velocity_rad_s / self.velocity_rad_s_per_lsb)
        cell = self.table[Register.PRESENT_VELOCITY]
        return _checked(raw, cell, "velocity", velocity_rad_s, "rad/s")


def _checked(raw: int, cell: RegisterField, what: str, value: float, unit: str) -> int:
    limit = 1 << (8 * cell.size - 1)
    if not -limit <= raw < limit:
        raise ValueError(f"{what} {value:g} {unit} does not fit a register of {cell.size} bytes")
    return raw


def _rpm(value: float) -> float:
    return value * 2.0 * math.pi / 60.0


_H54_LSB_A, _H42_LSB_A = 33.0 / 2048.0, 8.25 / 2048.0

X330: Final = replace(X_SERIES, name="X330", indirect=Indirect(168, 208, 20))
"""XL330: the table of the X with fewer indirect addresses (docs/sources.md, "Control tables")."""

MODELS: Final[Mapping[int, Model]] = {
    model.number: model
    for model in (
        Model(54024, "H54-200-S500-R", LEGACY_PRO, 501_923, 0, _H54_LSB_A, _rpm(0.00199234)),
        Model(51200, "H42-20-S300-R", LEGACY_PRO, 303_750, 0, _H42_LSB_A, _rpm(0.00329218)),
        Model(54025, "H54-200-S500-R(A)", PRO_P, 1_003_846, 0, 1e-3, _rpm(0.01)),
        Model(51201, "H42-20-S300-R(A)", PRO_P, 607_500, 0, 1e-3, _rpm(0.01)),
        Model(2020, "PH54-200-S500-R", PRO_P, 1_003_846, 0, 1e-3, _rpm(0.01)),
        Model(2000, "PH42-020-S300-R", PRO_P, 607_500, 0, 1e-3, _rpm(0.01)),
        Model(1020, "XM430-W350", X_SERIES, 4096, 2048, 2.69e-3, _rpm(0.229)),
        Model(1200, "XL330-M288", X330, 4096, 2048, 1e-3, _rpm(0.229)),
    )
}
"""Supported servo models, by model number."""


def model_named(name: str) -> Model:
    """Return the servo model of a name."""
    for model in MODELS.values():
        if model.name == name:
            return model
    known = ", ".join(model.name for model in MODELS.values())
    raise InputError(f"servo model {name!r}", "is not known", f"use one of {known}")
