"""Parser of SI units: exponents of the base units, as FMI requires.

A unit is written as a product and quotient of symbols, like "N.m.s/rad" or "rad/(N.m)"; "1" is
dimensionless.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Final

__all__ = ["base_exponents"]

_SYMBOLS: Final[dict[str, dict[str, int]]] = {
    "1": {},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "K": {"K": 1},
    "rad": {"rad": 1},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
}
_TOKEN = re.compile(r"[A-Za-z]+|1|-?\d+|[./()]")


def base_exponents(unit: str) -> dict[str, int]:
    """Return the exponents of kg, m, s, A, K and rad in a unit; zeros are left out.

    Parameters
    ----------
    unit : str
        Product and quotient of symbols; an integer after a symbol is its power.

    Raises
    ------
    ValueError
        If the text is not a unit.

    Examples
    --------
    >>> base_exponents("N.m/rad")
    {'kg': 1, 'm': 2, 's': -2, 'rad': -1}
    >>> base_exponents("1")
    {}
    """
    tokens = _TOKEN.findall(unit)
    if "".join(tokens) != unit or not tokens:
        raise ValueError(f"{unit!r} is not a unit")
    powers, rest = _product(tokens, unit)
    if rest:
        raise ValueError(f"{unit!r} is not a unit: {rest[0]!r} is out of place")
    return {symbol: power for symbol, power in powers.items() if power}


def _product(tokens: list[str], unit: str) -> tuple[Counter[str], list[str]]:
    powers, tokens = _factor(tokens, unit)
    while tokens and tokens[0] in "./":
        sign = 1 if tokens[0] == "." else -1
        factor, tokens = _factor(tokens[1:], unit)
        for symbol, power in factor.items():
            powers[symbol] += sign * power
    return powers, tokens


def _factor(tokens: list[str], unit: str) -> tuple[Counter[str], list[str]]:
    if not tokens:
        raise ValueError(f"{unit!r} is not a unit: it ends early")
    first, tokens = tokens[0], tokens[1:]
    if first == "(":
        powers, tokens = _product(tokens, unit)
        if not tokens or tokens[0] != ")":
            raise ValueError(f"{unit!r} is not a unit: a bracket stays open")
        return powers, tokens[1:]
    if first not in _SYMBOLS:
        raise ValueError(f"{unit!r} is not a unit: {first!r} is unknown")
    exponent = 1
    if tokens and re.fullmatch(r"-?\d+", tokens[0]):
        exponent, tokens = int(tokens[0]), tokens[1:]
    return Counter({s: exponent * p for s, p in _SYMBOLS[first].items()}), tokens
