"""Checks that the kinds of cases share: names of effects, ranges of numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from firmware_py.core.errors import InputError
from models.shared.catalogue import CATALOGUE


def check_effects_known(effects: Mapping[str, float]) -> None:
    """Refuse an effect that is not in the catalogue, or a strength that is not finite."""
    for effect, strength in effects.items():
        if effect not in CATALOGUE:
            raise InputError(
                f"effects.{effect}", "is no effect", "choose from " + ", ".join(CATALOGUE)
            )
        if not math.isfinite(strength):
            raise InputError(f"effects.{effect}", "is not finite", "give a finite strength")


def check_ranges(config: Any, **ranges: tuple[float, float]) -> None:
    """Refuse a number outside its range; None is accepted."""
    for name, (low, high) in ranges.items():
        value = getattr(config, name)
        values = value if isinstance(value, tuple) else (value,)
        for one in values:
            if one is not None and not low <= one <= high:
                raise InputError(name, f"is {one:g}", f"choose {low:g} to {high:g}")
