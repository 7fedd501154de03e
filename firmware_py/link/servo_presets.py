"""Servo presets: gear, torque constant, friction, inertia and limits of each model.

docs/sources.md, "The servo", has the source of every number. A link's file names a model and may
override any of these numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.core.errors import InputError

__all__ = ["PRESETS", "ServoPreset", "check_servo", "preset_named"]

COULOMB_FRACTION: Final = 0.39
"""Fraction of the friction at no-load speed that is Coulomb friction: 4.5 of 11.4 N·m, as assumed
for the H54 (docs/sources.md, "The servo")."""


_RANGES: Final = {
    "gear": (0.1, 5e4, ""),
    "torque_constant_nm_a": (3e-3, 700.0, "N.m/A"),
    "coulomb_friction_nm": (0.0, 500.0, "N.m"),
    "viscous_friction_nm_s_rad": (0.0, 200.0, "N.m.s/rad"),
    "load_friction": (0.0, 1.0, ""),
    "rotor_inertia_kg_m2": (1e-5, 90.0, "kg.m2"),
    "backlash_rad": (0.0, 0.3, "rad"),
    "current_limit_a": (0.01, 1e3, "A"),
    "speed_limit_rad_s": (0.03, 1e3, "rad/s"),
    "mass_kg": (1e-4, 50.0, "kg"),
}
"""Bounds and unit of each number: a hundred times below the XL330 and above the H54. They detect a
wrong unit, or a value for the motor's side of the gear."""


class ServoPreset(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Physical properties of a servo, at its output."""

    gear: float  # Turns of the motor per turn of the output
    torque_constant_nm_a: float  # Torque at the output per ampere
    coulomb_friction_nm: float
    viscous_friction_nm_s_rad: float
    load_friction: float  # Friction torque per transmitted torque
    rotor_inertia_kg_m2: float  # Inertia of the rotor, times the gear squared
    backlash_rad: float  # Play at the output
    current_limit_a: float  # Largest current
    speed_limit_rad_s: float  # Speed without load
    mass_kg: float
    source: str  # Source of the numbers

    @property
    def torque_limit_nm(self) -> float:
        """Torque at the current limit."""
        return self.torque_constant_nm_a * self.current_limit_a


def _rpm(value: float) -> float:
    return value * 2.0 * math.pi / 60.0


def _friction(torque_constant_nm_a: float, current_a: float, rpm: float) -> tuple[float, float]:
    """Return Coulomb and viscous friction from current and speed without load."""
    whole_nm = torque_constant_nm_a * current_a
    viscous = (1 - COULOMB_FRACTION) * whole_nm / _rpm(rpm)
    return round(COULOMB_FRACTION * whole_nm, 4), round(viscous, 5)


def _preset(
    gear: float, constant: float, no_load: tuple[float, float], *, inertia: float, limit: float,
    mass: float, backlash: float, source: str,
) -> ServoPreset:  # fmt: skip
    coulomb, viscous = _friction(constant, *no_load)
    return ServoPreset(
        gear=gear, torque_constant_nm_a=constant, coulomb_friction_nm=coulomb,
        viscous_friction_nm_s_rad=viscous, load_friction=0.14, rotor_inertia_kg_m2=inertia,
        backlash_rad=backlash, current_limit_a=limit, speed_limit_rad_s=round(_rpm(no_load[1]), 3),
        mass_kg=mass, source=source,
    )  # fmt: skip


_H54: Final = ServoPreset(
    gear=501.923, torque_constant_nm_a=6.83, coulomb_friction_nm=4.5,
    viscous_friction_nm_s_rad=2.0, load_friction=0.14, rotor_inertia_kg_m2=0.84,
    backlash_rad=0.0006, current_limit_a=10.0, speed_limit_rad_s=3.466, mass_kg=0.855,
    source="data sheet; rotor inertia recalled; split of friction, load friction, play assumed",
)  # fmt: skip
_H42: Final = _preset(
    303.75, 5.48, (0.57, 32.7), inertia=0.096, limit=1.5, mass=0.34, backlash=0.0006,
    source="data sheet of the H42P: 5.1 N.m at 1.5 A, no load 0.57 A at 32.7 rpm; rotor inertia "
    "assumed in proportion to the H54's torque",
)  # fmt: skip
_XM430: Final = _preset(
    353.5, 1.783, (0.12, 46.0), inertia=0.045, limit=2.3, mass=0.082, backlash=0.0015,
    source="data sheet: stall 4.1 N.m at 2.3 A, 46 rpm (12 V), play below 15'; rotor inertia of "
    "MuJoCo Menagerie's robotis_op3; no-load current assumed",
)  # fmt: skip
_XL330: Final = _preset(
    288.4, 0.354, (0.1, 103.0), inertia=0.0012, limit=1.47, mass=0.018, backlash=0.003,
    source="data sheet: stall 0.52 N.m at 1.47 A, 103 rpm (5 V); rotor inertia identified in "
    "models/plant/examples/xl330_pendulum_identified.json; no-load current and play assumed",
)  # fmt: skip

PRESETS: Final[Mapping[str, ServoPreset]] = {
    "H54-200-S500-R": _H54,
    "H54-200-S500-R(A)": _H54,
    "PH54-200-S500-R": _H54,
    "H42-20-S300-R": _H42,
    "H42-20-S300-R(A)": _H42,
    "PH42-020-S300-R": _H42,
    "XM430-W350": _XM430,
    "XL330-M288": _XL330,
}
"""Presets by model name, as in `firmware_py.bus.servo_models.MODELS`."""


def preset_named(name: str) -> ServoPreset:
    """Return the preset of a model."""
    if name not in PRESETS:
        raise InputError(
            f"servo model {name!r}", "is not known", f"use one of {', '.join(PRESETS)}"
        )
    return PRESETS[name]


def check_servo(servo: ServoPreset, where: Path | str) -> None:
    """Refuse numbers that are out of range for any servo."""
    for name, (low, high, unit) in _RANGES.items():
        value = getattr(servo, name)
        if not low <= value <= high:
            raise InputError(
                where, f"servo.{name} is {value:g} {unit}".rstrip() + f", outside {low:g} to "
                f"{high:g}", f"give it in {unit}, at the output" if unit else "correct it",
            )  # fmt: skip
