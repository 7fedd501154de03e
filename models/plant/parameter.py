"""Parameter of a plant, its scaling to a described link, and sums of parameters with a limit."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from typing import Final, Literal, NamedTuple

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.link.link_description import STUDY_LINK, LinkDescription
from models.shared.link_scale import LinkScale
from models.trials.units import exponents_in

Role = Literal["nuisance", "effect", "calibration", "fixed"]
"""Treatment of a parameter by `identify`.

`nuisance` differs from link to link (stiffness, mass, damping, friction) and is always fitted;
`effect` belongs to an effect of the plant and is fitted with it; `calibration` maps the bend to
the markers and is fitted to the Deformation Index; `fixed` is measured or known.
"""

NO_DEFAULT: Final = math.nan
"""Value of a parameter that every plant file must set. A constant of one machine, such as the force
per volt of its drive, is no default for another, and no trial reveals that it is wrong."""


class Parameter(msgspec.Struct, frozen=True):
    """One number of the plant, declared as a row: name, unit, value, bounds, meaning, source.

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
    description, source : str
        Meaning in one phrase, and origin of value and bounds.
    role : str
        How `identify` treats it, see `Role`.
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
    description: str = ""
    source: str = ""
    role: Role = "fixed"
    error: float | None = None
    prior_deviation: float | None = None


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


def check_payload(
    payload_kg: float, option: str = "--payload-kg", link: LinkDescription | None = None
) -> None:
    """Refuse a payload outside the range of a link's plant."""
    most_kg = (link or STUDY_LINK).most_payload_kg
    if not 0.0 <= payload_kg <= most_kg:
        raise InputError(option, f"is {payload_kg:g} kg", f"give 0 to {most_kg:g} kg")


def parameter_of_link(q: Parameter, scale: LinkScale) -> Parameter:
    """Parameter of the study's plant, scaled to another link.

    Value, bounds and prior are multiplied by the ratio of the property that the parameter depends
    on, so the bounds keep their relative distance from the value.
    """
    link = scale.link
    described = {
        "base_offset_m": link.base_offset_m,
        "link_length_m": link.length_m,
        "link_width_m": link.width_m,
        "gravity_m_s2": link.gravity.size_m_s2,
    }
    if q.name in described:
        return msgspec.structs.replace(q, value=described[q.name], source="link.toml")
    if q.name == "span_position":  # between the same bounds
        return msgspec.structs.replace(q, value=q.value * scale.over_study(q.name))
    if q.name == "payload_known_kg":  # its negative value asks for an estimate
        return msgspec.structs.replace(q, high=link.most_payload_kg)
    ratio = _ratios(scale).get(re.sub(r"_[12](?=_|$)", "", q.name))
    if ratio is None:
        ratio = scale.ratio_of_unit(exponents_in(f"parameter {q.name}", q.unit))
    if ratio == 1.0:
        return q
    return msgspec.structs.replace(
        q, value=q.value * ratio, low=min(q.low * ratio, q.value * ratio), high=q.high * ratio,
        prior_deviation=q.prior_deviation and q.prior_deviation * ratio,
        source=f"{q.source}; scaled by {ratio:.3g} for this link",
    )  # fmt: skip


def _ratios(scale: LinkScale) -> dict[str, float]:
    """Scale factors by name, without the joint's number.

    They are of the parameters that depend on more than the servo's torque and current, which follow
    from the unit (`LinkScale.ratio_of_unit`).
    """
    servo, over = scale.servo_ratios, scale.over_study
    inertia, constant = servo["rotor_inertia_kg_m2"], servo["torque_constant_nm_a"]
    damping_s = 1 / over("first_mode_rad_s")
    payload = scale.link.payload_kg / STUDY_LINK.payload_kg
    length = scale.link.length_m / STUDY_LINK.length_m
    width = scale.link.width_m / STUDY_LINK.width_m
    ratios = {
        "velocity_gain_a_s_rad": inertia / constant,
        "torque_constant_nm_a": constant,
        "base_mass_kg": over("plate_m2"),
        "link_mass_kg": over("mass_kg"),
        "tip_mass_kg": over("tip_mass_kg"),
        "root_limit_moment_nm": over("limit_moment_nm"),
        "root_stiffness_nm_rad": over("root_nm_rad"),
        "span_stiffness_nm_rad": over("span_nm_rad"),
        "root_damping_nm_s_rad": over("root_nm_rad") * damping_s,
        "span_damping_nm_s_rad": over("span_nm_rad") * damping_s,
        "viscous_friction_nm_s_rad": servo["viscous_friction_nm_s_rad"],
        "load_dependent_friction": servo["load_friction"],
        "joint_elasticity_rad_nm": 1 / inertia,
        "unmodelled_payload_kg": max(payload, 0.1 * over("tip_mass_kg")),
        "aerodynamic_drag_nm": width * length**4,
        "payload_prior_kg": payload,
        "payload_spread_kg": max(payload, 0.05),
    }
    for ratio, alike in (
        (inertia, ("rotor_inertia_kg_m2", "plate_inertia_kg_m2", "gear_damping_nm_s_rad")),
        (servo["coulomb_friction_nm"],
         ("coulomb_friction_nm", "stribeck_friction_nm", "stiction_nm")),
    ):  # fmt: skip
        ratios |= dict.fromkeys(alike, ratio)
    return ratios


class ImpossibleSum(NamedTuple):
    """Sum of parameters below zero, which no real machine has."""

    what: str
    unit: str
    value: float
    parameters: tuple[str, ...]


SUMS: Final[tuple[tuple[str, str, dict[str, int]], ...]] = (
    ("mass at the tip with payload", "kg",
     {"tip_mass_kg": 1, "mass_kg": 1, "unmodelled_payload_kg": 1}),
    ("friction at standstill of joint {j}", "N.m",
     {"coulomb_friction_{j}_*": 1, "stribeck_friction_{j}_*": 1}),
    ("current limit of joint {j}", "A", {"current_limit_{j}_a": 1, "current_saturation_{j}_a": -1}),
)  # fmt: skip
"""What, unit and weights of the parameters by name; {j} stands for a joint, * for any text.

Two parameters within their bounds can still add up to something impossible: a payload of −0.2 kg on
tip hardware of 0.14 kg. The bounds alone keep every other parameter possible.
"""


def impossible_sums(
    values: Mapping[str, float], payloads_kg: Iterable[float] = (0.0,)
) -> list[ImpossibleSum]:
    """Sums that the values violate; the mass at the tip with the smallest of the payloads."""
    impossible = []
    for what, unit, patterns in SUMS:
        for joint in ("1", "2") if "{j}" in what else ("",):
            weights = {
                name: weight
                for pattern, weight in patterns.items()
                for name in values
                if fnmatchcase(name, pattern.replace("{j}", joint))
            }
            value = sum(weight * values[name] for name, weight in weights.items())
            value += min(payloads_kg, default=0.0) if unit == "kg" else 0.0
            if weights and (value < 0 or (value == 0 and unit == "A")):
                parameters = tuple(weights)
                impossible.append(ImpossibleSum(what.format(j=joint), unit, value, parameters))
    return impossible
