"""Physical limits: the largest payload, and sums of parameters that cannot be negative.

Every parameter has bounds (`models.plant.parameter`). Two parameters within their bounds can still
add up to something impossible: a payload of −0.2 kg on tip hardware of 0.14 kg. `LIMITS` declares
such sums of masses, friction, stiffness and limits for all plants; a sum is ignored if the plant
has none of its parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final

from firmware_py.errors import InputError
from firmware_py.link.link_description import STUDY_LINK, LinkDescription

__all__ = [
    "LIMITS",
    "ImpossibleSum",
    "PhysicalLimit",
    "check_payload",
    "impossible_sums",
]

JOINTS: Final = ("1", "2")


@dataclass(frozen=True)
class PhysicalLimit:
    """Sum of parameters that must be positive, or at least not negative."""

    what: str  # Name of the sum for messages
    unit: str
    # Weight of each parameter; in a name, {j} stands for a joint and * for any text
    weights: Mapping[str, float]
    constant: float = 0.0  # Constant term of the sum
    with_payload: bool = False  # Whether a trial's payload in kg is added
    may_vanish: bool = True  # Whether the sum may be zero


@dataclass(frozen=True)
class ImpossibleSum:
    """Sum that violates its limit."""

    what: str
    unit: str
    value: float
    parameters: tuple[str, ...]


LIMITS: Final = (
    PhysicalLimit("mass at the tip with payload", "kg",
                  {"tip_mass_kg": 1, "mass_kg": 1, "unmodelled_payload_kg": 1}, with_payload=True),
    PhysicalLimit("friction at standstill of joint {j}", "N.m",
                  {"coulomb_friction_{j}_*": 1, "stribeck_friction_{j}_*": 1}),
    PhysicalLimit("viscous friction of joint {j}", "N.m.s/rad", {"viscous_friction_{j}_*": 1}),
    PhysicalLimit("friction per torque of joint {j}", "1", {"load_dependent_friction_{j}": 1}),
    PhysicalLimit("root stiffness of plane {j}", "N.m/rad", {"root_stiffness_{j}_nm_rad": 1},
                  may_vanish=False),
    PhysicalLimit("span stiffness of plane {j}", "N.m/rad", {"span_stiffness_{j}_nm_rad": 1},
                  may_vanish=False),
    PhysicalLimit("stiffness left on the weak side of plane {j}", "1",
                  {"directional_stiffness_{j}": -1}, constant=1, may_vanish=False),
    PhysicalLimit("stiffness left on the other side of plane {j}", "1",
                  {"directional_stiffness_{j}": 1}, constant=1, may_vanish=False),
    PhysicalLimit("stiffness left at 0.1 rad of bend", "1", {"softening_share": -1}, constant=1,
                  may_vanish=False),
    PhysicalLimit("stiffness left after 10 s", "1", {"leak_share": -1}, constant=1,
                  may_vanish=False),
    PhysicalLimit("current limit of joint {j}", "A",
                  {"current_limit_{j}_a": 1, "current_saturation_{j}_a": -1}, may_vanish=False),
    PhysicalLimit("torque per ampere of joint {j}, relative", "1",
                  {"torque_constant_drift_{j}": -1}, constant=1, may_vanish=False),
    PhysicalLimit("measured per true current of joint {j}", "1", {"current_scale_{j}": 1},
                  constant=1, may_vanish=False),
)  # fmt: skip
"""Sums that no real machine violates, from the meaning of their parameters
(`models.plant.effects`)."""


def impossible_sums(
    values: Mapping[str, float], payloads_kg: Iterable[float] = (0.0,)
) -> list[ImpossibleSum]:
    """Sums of `LIMITS` that the values violate at the smallest payload."""
    least_payload_kg = min(payloads_kg, default=0.0)
    found = []
    for limit in LIMITS:
        many = any("{j}" in pattern for pattern in limit.weights)
        for joint in JOINTS if many else ("",):
            weights = {
                name: weight
                for pattern, weight in limit.weights.items()
                for name in values
                if fnmatchcase(name, pattern.replace("{j}", joint))
            }
            if not weights:
                continue
            value = limit.constant + sum(w * values[name] for name, w in weights.items())
            value += least_payload_kg if limit.with_payload else 0.0
            if value < 0 or (value == 0 and not limit.may_vanish):
                what = limit.what.replace("{j}", joint)
                found.append(ImpossibleSum(what, limit.unit, value, tuple(weights)))
    return found


def check_payload(
    payload_kg: float, option: str = "--payload-kg", link: LinkDescription | None = None
) -> None:
    """Refuse a payload outside the range of a link's plant."""
    most_kg = (link or STUDY_LINK).most_payload_kg
    if not 0.0 <= payload_kg <= most_kg:
        raise InputError(option, f"is {payload_kg:g} kg", f"give 0 to {most_kg:g} kg")
