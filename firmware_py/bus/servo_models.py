"""The servo models, and the one place where raw register values become SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from firmware_py.bus.registers import (
    LEGACY_PRO,
    PRO_P,
    X_SERIES,
    ControlTable,
    Register,
    RegisterField,
)
from firmware_py.errors import InputError


def round_half_away(value: float) -> int:
    """Round to the nearest integer, halves away from zero.

    Symmetric about zero, which Python's own rounding (half to even) is not over pulses: goals of
    +x and −x give opposite pulses.

    Raises
    ------
    ValueError
        If the value is not finite.
    """
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    magnitude = math.floor(abs(value))
    if abs(value) - magnitude >= 0.5:  # exact, where adding 0.5 first could round up 0.49999…
        magnitude += 1
    return -magnitude if value < 0 else magnitude


@dataclass(frozen=True)
class Model:
    """One servo model: its table and its resolutions.

    Attributes
    ----------
    number : int
        What the model number register holds.
    name : str
        Name on the type plate.
    table : ControlTable
        Its registers.
    pulses_per_turn : int
        Of the output shaft.
    zero_pulse : int
        Raw position at zero angle (PRO and P count from −, X from 0 to 4095).
    current_a_per_lsb, velocity_rad_s_per_lsb : float
        Resolutions of current and velocity.
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
        """Resolution of the position."""
        return 2.0 * math.pi / self.pulses_per_turn

    def angle_rad(self, raw: int) -> float:
        """Angle of a raw position."""
        return (raw - self.zero_pulse) * self.rad_per_pulse

    def position_raw(self, angle_rad: float) -> int:
        """Raw position nearest to an angle.

        Raises
        ------
        ValueError
            If the angle is not finite or does not fit the register.
        """
        raw = self.zero_pulse + round_half_away(angle_rad / self.rad_per_pulse)
        return _checked(raw, self.table[Register.GOAL_POSITION], "angle", angle_rad, "rad")

    def current_a(self, raw: int) -> float:
        """Current of a raw value."""
        return raw * self.current_a_per_lsb

    def current_raw(self, current_a: float) -> int:
        """Raw value nearest to a current; errors as `position_raw`."""
        raw = round_half_away(current_a / self.current_a_per_lsb)
        return _checked(raw, self.table[Register.PRESENT_CURRENT], "current", current_a, "A")

    def velocity_rad_s(self, raw: int) -> float:
        """Angular velocity of a raw value."""
        return raw * self.velocity_rad_s_per_lsb

    def velocity_raw(self, velocity_rad_s: float) -> int:
        """Raw value nearest to an angular velocity; errors as `position_raw`."""
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
    )
}
"""Every servo model that this project knows, by model number."""


def model_named(name: str) -> Model:
    """Return the model of that name.

    Raises
    ------
    InputError
        If there is none; the remedy lists those that there are.
    """
    for model in MODELS.values():
        if model.name == name:
            return model
    known = ", ".join(model.name for model in MODELS.values())
    raise InputError(f"servo model {name!r}", "is not known", f"use one of {known}")
