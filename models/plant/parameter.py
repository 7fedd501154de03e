"""Parameter of a plant: value, bounds, unit, role and source."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final, Literal

import msgspec

from firmware_py.errors import InputError

__all__ = [
    "NO_DEFAULT", "Parameter", "Role", "bound_reached", "check_values", "is_weakly_determined",
    "prior_deviation_of",
]  # fmt: skip

Role = Literal["nuisance", "effect", "calibration", "fixed"]
"""Treatment of a parameter by `identify`.

`nuisance` differs from link to link (stiffness, mass, damping, friction) and is always fitted;
`effect` belongs to an effect of the plant and is fitted with it; `calibration` maps the bend to
the markers and is fitted to the Deformation Index; `fixed` is measured or known.
"""


class Parameter(msgspec.Struct, frozen=True, kw_only=True):
    """One number of the plant.

    Attributes
    ----------
    name : str
        Name with its unit suffix, and the plane (1 or 2) if there is one per plane.
    unit : str
        SI unit in the spelling of FMI, "1" if dimensionless.
    value : float
        Current value; `NO_DEFAULT` for a constant of the machine that has no default.
    low, high : float
        Physically possible range; a fit stays within it.
    role : str
        How `identify` treats it, see `Role`.
    description : str
        Meaning, one phrase.
    source : str
        Origin of value and bounds.
    error : float or None
        Standard error of an identified value.
    prior_deviation : float or None
        Standard deviation before a fit; None for a quarter of the distance between the bounds.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    role: Role = "fixed"
    description: str = ""
    source: str = ""
    error: float | None = None
    prior_deviation: float | None = None


NO_DEFAULT: Final = math.nan
"""Value of a parameter that every plant file must set. A constant of one machine, such as the force
per volt of its drive, is no default for another, and no trial reveals that it is wrong."""

AT_BOUND: Final = 1e-3
"""Fraction of the distance between the bounds within which a value counts as at one [assumed]."""


def bound_reached(q: Parameter) -> Literal["lower", "upper"] | None:
    """Bound that a parameter's value has reached; None if it lies between them."""
    margin = AT_BOUND * (q.high - q.low)
    return "lower" if q.value <= q.low + margin else "upper" if q.value >= q.high - margin else None


def prior_deviation_of(q: Parameter) -> float:
    """Prior standard deviation of a value, in the parameter's unit."""
    return q.prior_deviation or (q.high - q.low) / 4


def is_weakly_determined(q: Parameter) -> bool:
    """Whether a fit added no information: the standard error is not below the prior deviation."""
    return q.error is not None and q.error >= prior_deviation_of(q)


def check_values(where: str, parameters: Iterable[Parameter]) -> None:
    """Refuse a value that is missing or outside its bounds."""
    for q in parameters:
        if math.isnan(q.value):
            raise InputError(
                where,
                f"parameter {q.name} ({q.description}) is missing and has no default",
                f"give it in {q.unit} under [parameters]",
            )
        if not q.low <= q.value <= q.high:
            raise InputError(
                where,
                f"parameter {q.name} is {q.value:g} {q.unit}, outside {q.low:g} to {q.high:g}",
                "give a value within the bounds, or wider bounds",
            )
