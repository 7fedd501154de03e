"""Servo models as `servos.toml` has them, and the conversion of raw register values to SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import msgspec

from firmware_py.bus.registers import ControlTable, Indirect, Register, RegisterField
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert

__all__ = [
    "GAINS",
    "MODELS",
    "PRESETS",
    "Model",
    "ServoGains",
    "ServoPreset",
    "check_models",
    "check_servo",
    "model_named",
    "read_models",
]


T = TypeVar("T")

_FILE: Final = Path(__file__).with_name("servos.toml")


class ServoGains(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Gains with which the plant was identified (`gains` in `[[servos]]`), as register values."""

    position_p: int | None = None  # Register value; None skips the comparison
    position_i: int | None = None
    position_d: int | None = None
    velocity_p: int | None = None
    velocity_i: int | None = None

    def registers(self) -> dict[Register, int]:
        values = {register: getattr(self, name) for name, register in GAINS.items()}
        return {register: raw for register, raw in values.items() if raw is not None}


GAINS: Final = {
    "position_p": Register.POSITION_P_GAIN,
    "position_i": Register.POSITION_I_GAIN,
    "position_d": Register.POSITION_D_GAIN,
    "velocity_p": Register.VELOCITY_P_GAIN,
    "velocity_i": Register.VELOCITY_I_GAIN,
}
"""Register of each gain in `ServoGains`."""


class ServoPreset(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Physical properties of a servo, at its output; a link's file may override any of them."""

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


def check_servo(servo: ServoPreset, where: Path | str) -> None:
    """Refuse numbers that are out of range for any servo."""
    for name, (low, high, unit) in _RANGES.items():
        value = getattr(servo, name)
        if not low <= value <= high:
            raise InputError(
                where, f"servo.{name} is {value:g} {unit}".rstrip() + f", outside {low:g} to "
                f"{high:g}", f"give it in {unit}, at the output" if unit else "correct it",
            )  # fmt: skip


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
    """Servo model: control table, and conversion of raw register values to SI units."""

    number: int  # Value of the register Model Number, which identifies the servo
    name: str  # Name on the type plate
    table: ControlTable  # Registers of the servo's family
    factory: Mapping[Register, int]  # Raw values from the factory
    preset: ServoPreset
    pulses_per_turn: int
    zero_pulse: int  # Raw position at zero angle: 0 for PRO and P, whose positions are signed
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
        """Return the raw position nearest to an angle; ValueError if it does not fit."""
        raw = self.zero_pulse + round_half_away(angle_rad / self.rad_per_pulse)
        size = self.table[Register.GOAL_POSITION].size
        limit = 1 << (8 * size - 1)
        if not -limit <= raw < limit:
            raise ValueError(f"angle {angle_rad:g} rad does not fit a register of {size} bytes")
        return raw

    def current_a(self, raw: int) -> float:
        """Return the current of a raw value, in A."""
        return raw * self.current_a_per_lsb


class _Family(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    ram_start: int
    indirect: Indirect
    fast_sync_read: bool
    factory: dict[str, int]
    like: str | None = None
    registers: dict[str, tuple[int, str, Literal["r", "rw"]]] = {}


class _Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    number: int
    family: str
    motor: str
    pulses_per_turn: int
    zero_pulse: int
    current_a_per_lsb: float
    velocity_rpm_per_lsb: float
    factory: dict[str, int] = {}


class _Servos(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    families: dict[str, Any]
    models: dict[str, Any]
    motors: dict[str, Any]


def read_models(toml: bytes | str) -> dict[int, Model]:
    """Read servo models in the form of `servos.toml`, by model number."""
    try:
        servos = msgspec.toml.decode(toml, type=_Servos)
    except ValueError as error:
        raise InputError(_FILE.name, f"cannot be read ({error})", "correct it") from error
    families = _rows("families", servos.families, _Family)
    motors = _rows("motors", servos.motors, ServoPreset)
    tables: dict[str, ControlTable] = {}
    for name, family in families.items():
        where = f'[families."{name}"]'
        cells = {_register(each, where): _cell(*row) for each, row in family.registers.items()}
        if family.like is not None:
            cells = _with_ram_at(family.ram_start, _named(family.like, "families", tables, where))
        tables[name] = ControlTable(
            name, cells, family.ram_start, family.indirect, family.fast_sync_read
        )
    models: dict[int, Model] = {}
    for name, row in _rows("models", servos.models, _Row).items():
        where = f'[models."{name}"]'
        if row.number in models:
            raise InputError(
                _FILE.name, f"{where} has the number {row.number} of {models[row.number].name}",
                "give each model the number of its e-Manual page",
            )  # fmt: skip
        table = _named(row.family, "families", tables, where)
        factory = families[row.family].factory | row.factory
        models[row.number] = Model(
            number=row.number,
            name=name,
            table=table,
            factory={_register(each, where): raw for each, raw in factory.items()},
            preset=_named(row.motor, "motors", motors, where),
            pulses_per_turn=row.pulses_per_turn,
            zero_pulse=row.zero_pulse,
            current_a_per_lsb=row.current_a_per_lsb,
            velocity_rad_s_per_lsb=row.velocity_rpm_per_lsb * 2.0 * math.pi / 60.0,
        )
    return models


def _rows(kind: str, tables: dict[str, Any], row: type[T]) -> dict[str, T]:
    return {
        name: convert(table, row, _FILE.name, f'[{kind}."{name}"]', "correct this table")
        for name, table in tables.items()
    }


def _named(name: str, kind: str, tables: Mapping[str, T], where: str) -> T:
    """Return the table that another one, `where`, refers to."""
    if name not in tables:
        raise InputError(
            _FILE.name, f"{where} refers to {name!r}, which [{kind}] does not have",
            f'add [{kind}."{name}"], or choose from {", ".join(tables)}',
        )  # fmt: skip
    return tables[name]


def _register(name: str, where: str) -> Register:
    try:
        return Register(name)
    except ValueError:
        raise InputError(
            _FILE.name, f"{where} has the register {name!r}, which is not known",
            "write it as in another family, or add it to registers.py",
        ) from None  # fmt: skip


def _cell(address: int, kind: str, access: str) -> RegisterField:
    return RegisterField(address, int(kind[1:]), kind[0] == "i", access == "rw")


def _with_ram_at(ram_start: int, table: ControlTable) -> dict[Register, RegisterField]:
    """Return the registers of a table with its RAM area moved to an address."""
    shift = ram_start - table.ram_start
    return {
        register: cell._replace(address=cell.address + shift * (cell.address >= table.ram_start))
        for register, cell in table.cells.items()
    }


MODELS: Final[Mapping[int, Model]] = read_models(_FILE.read_bytes())
"""Supported servo models, by model number."""

PRESETS: Final[Mapping[str, ServoPreset]] = {m.name: m.preset for m in MODELS.values()}
"""Presets by model name."""


def model_named(name: str) -> Model:
    """Return the servo model of a name."""
    for model in MODELS.values():
        if model.name == name:
            return model
    raise InputError(f"servo model {name!r}", "is not known", f"use one of {', '.join(PRESETS)}")


def check_models(names: Sequence[str], where: Path | str) -> None:
    """Refuse the model of an entry of `[[servos]]` that is not known."""
    for k, name in enumerate(names):
        if name not in PRESETS:
            raise InputError(
                where, f"servos[{k}].model is {name!r}, which is not known",
                f"use one of {', '.join(PRESETS)}",
            )  # fmt: skip
