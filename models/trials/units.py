"""SI units: exponents of base units, factors to SI, and the check of a plant's signal units.

A unit is written as FMI requires: a product and quotient of symbols, like "N.m.s/rad" or
"rad/(N.m)"; "1" is dimensionless.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from firmware_py.core.errors import InputError
from firmware_py.core.signals import unit_of
from models.trials.trial import SignalRole

TO_SI: Final[dict[str, tuple[str, float]]] = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9),
    "rad": ("rad", 1.0), "mrad": ("rad", 1e-3), "deg": ("rad", math.pi / 180),
    "turn": ("rad", 2 * math.pi), "rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", math.pi / 180),
    "rpm": ("rad/s", math.pi / 30), "A": ("A", 1.0), "mA": ("A", 1e-3), "V": ("V", 1.0),
    "mV": ("V", 1e-3), "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3),
    "inch": ("m", 0.0254), "m/s": ("m/s", 1.0), "mm/s": ("m/s", 1e-3), "kg": ("kg", 1.0),
    "g": ("kg", 1e-3), "N": ("N", 1.0), "kN": ("N", 1e3), "N.m": ("N.m", 1.0),
    "N.mm": ("N.m", 1e-3), "Pa": ("Pa", 1.0), "kPa": ("Pa", 1e3), "bar": ("Pa", 1e5),
    "psi": ("Pa", 6894.757), "degC": ("degC", 1.0), "Hz": ("Hz", 1.0), "W": ("W", 1.0),
    "1": ("1", 1.0),
}  # fmt: skip
"""SI unit of the trial files and the factor to it, by the unit that a map may name."""


def factor_to_si(where: Path, column: str, unit: str, declared: str | None = None) -> float:
    """Factor from `unit` to the SI unit of `column`, from its suffix or `declared` without one."""
    declared = declared or unit_of(column) or "1"
    if unit == declared:
        return 1.0
    if unit not in TO_SI:
        raise InputError(
            where, f"{column}: unit {unit!r} is unknown", "choose from " + ", ".join(TO_SI)
        )
    si, factor = TO_SI[unit]
    if si != declared:
        alike = ", ".join(name for name, (other, _) in TO_SI.items() if other == declared)
        raise InputError(
            where, f"{column}: unit {unit!r} does not measure {declared}", f"give one of {alike}"
        )
    return factor


_SYMBOLS: Final[dict[str, dict[str, int]]] = {
    "1": {}, "kg": {"kg": 1}, "m": {"m": 1}, "s": {"s": 1}, "A": {"A": 1}, "K": {"K": 1},
    "rad": {"rad": 1}, "Hz": {"s": -1}, "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2}, "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3}, "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
}  # fmt: skip
_FACTOR = re.compile(r"([./]?)(\(*)([A-Za-z]+|1)(-?\d+)?(\)*)")
"""Operator, opened brackets, symbol, power, closed brackets."""


def symbol_exponents(unit: str) -> dict[str, int]:
    """Return the exponents of the symbols in a unit, as they are written; zeros are omitted.

    A unit is a product and quotient of symbols; an integer after a symbol is its power.
    """
    powers: Counter[str] = Counter()
    signs, end = [1], 0  # Sign of each open bracket, and of the factor
    while factor := _FACTOR.match(unit, end):
        operator, opened, symbol, power, closed = factor.groups()
        signs += [-signs[-1] if operator == "/" else signs[-1]] * (len(opened) + 1)
        if bool(operator) != (end > 0) or symbol not in _SYMBOLS or len(closed) > len(signs) - 2:
            break
        powers[symbol] += signs[-1] * int(power or 1)
        del signs[len(signs) - 1 - len(closed) :]
        end = factor.end()
    if end < len(unit) or not unit or len(signs) > 1:
        raise ValueError(f"{unit!r} is not a unit")
    del powers["1"]
    return {symbol: power for symbol, power in powers.items() if power}


def exponents_in(where: Path | str, unit: str) -> dict[str, int]:
    """Return `symbol_exponents`; InputError if the text is not a unit."""
    try:
        return symbol_exponents(unit)
    except ValueError:
        raise InputError(
            where, f"has the unit {unit!r}, which is not known",
            "write a product and quotient of SI units, like N.m.s/rad",
        ) from None  # fmt: skip


def base_exponents(unit: str) -> dict[str, int]:
    """Return the exponents of kg, m, s, A, K and rad in a unit; zeros are omitted."""
    powers: Counter[str] = Counter()
    for symbol, power in symbol_exponents(unit).items():
        for base, exponent in _SYMBOLS[symbol].items():
            powers[base] += power * exponent
    return {symbol: power for symbol, power in powers.items() if power}


def check_signal_units(where: Path, signals: Mapping[str, SignalRole]) -> None:
    """Refuse a signal of a plant's file whose unit is not that of its quantity.

    The suffix of the plant's name of a signal states its unit. A condition has the unit of the
    parameter that it replaces (`models.plant.plant.read_plant`). A condition, or a name without a
    suffix, must have an SI unit here.
    """
    for name, signal in signals.items():
        quantity = signal.quantity or name
        expected = None if signal.role == "condition" else unit_of(quantity)
        if expected is not None and signal.unit != expected:
            named = f"its quantity {quantity} in" if signal.quantity else "its name says"
            raise other_unit(where, name, signal, f"{named} {expected!r}", expected)
        if expected is None and not _is_si(signal.unit):
            known = TO_SI.get(signal.unit, ("an SI unit like 'm', 'rad/s' or 'N.m'", 1.0))[0]
            raise other_unit(where, name, signal, "which is no SI unit", known)


def other_unit(
    where: Path, name: str, signal: SignalRole, contrast: str, expected: str
) -> InputError:
    """Error of a signal with a wrong unit; `contrast` says why it is wrong."""
    wanted = repr(expected) if " " not in expected else expected
    return InputError(
        where,
        f"signal {name} is in {signal.unit!r}, {contrast}",
        f"give {wanted} here, the map of the import converts the recording",
    )


def _is_si(unit: str) -> bool:
    """Whether a text is an SI unit; degC is accepted for temperatures."""
    try:
        base_exponents(unit)
    except ValueError:
        return unit == "degC"
    return True
