"""Values, bounds and priors of a plant's parameters for a described link.

Each is that of the study's link (`read_plant()`) times the ratio of the property that it depends on
(`models.shared.link_scale`), so the bounds keep their relative distance from the value.
"""

from __future__ import annotations

import re
from typing import Final

import msgspec

from firmware_py.link.link_description import STUDY_LINK
from models.plant.parameter import Parameter
from models.shared.link_scale import LinkScale

__all__ = ["parameter_of_link"]

_JOINT = re.compile(r"_[12](?=_|$)")
_KNOWN_PAYLOAD: Final = "payload_known_kg"
"""Known payload; negative if it is to be estimated, so it is not scaled."""


def parameter_of_link(parameter: Parameter, scale: LinkScale) -> Parameter:
    """Parameter of the study's plant, scaled to another link."""
    q, link = parameter, scale.link
    own = {
        "base_offset_m": link.base_offset_m,
        "link_length_m": link.length_m,
        "link_width_m": link.width_m,
        "gravity_m_s2": link.gravity.size_m_s2,
    }
    if q.name in own:
        return msgspec.structs.replace(q, value=own[q.name], source="link.toml")
    if q.name == _KNOWN_PAYLOAD:
        return msgspec.structs.replace(q, high=link.most_payload_kg)
    ratio = _ratio(_JOINT.sub("", q.name), scale)
    if ratio == 1.0:
        return q
    return msgspec.structs.replace(
        q, value=q.value * ratio, low=min(q.low * ratio, q.value * ratio), high=q.high * ratio,
        prior_deviation=q.prior_deviation and q.prior_deviation * ratio,
        source=f"{q.source}; scaled by {ratio:.3g} for this link",
    )  # fmt: skip


def _ratio(name: str, scale: LinkScale) -> float:
    """Scale factor of a parameter; `name` is without the joint's number."""
    servo, over = scale.servo_ratios, scale.over_study
    inertia, constant = servo["rotor_inertia_kg_m2"], servo["torque_constant_nm_a"]
    damping_s = 1 / over("first_mode_rad_s")
    payload = scale.link.payload_kg / STUDY_LINK.payload_kg
    length = scale.link.length_m / STUDY_LINK.length_m
    width = scale.link.width_m / STUDY_LINK.width_m
    ratios = {
        "velocity_gain_a_s_rad": inertia / constant,
        "torque_constant_nm_a": constant,
        "rotor_inertia_kg_m2": inertia,
        "current_limit_a": servo["current_limit_a"],
        "base_mass_kg": over("plate_m2"),
        "link_mass_kg": over("mass_kg"),
        "tip_mass_kg": over("tip_mass_kg"),
        "root_limit_moment_nm": over("limit_moment_nm"),
        "root_stiffness_nm_rad": over("root_nm_rad"),
        "span_stiffness_nm_rad": over("span_nm_rad"),
        "root_damping_nm_s_rad": over("root_nm_rad") * damping_s,
        "span_damping_nm_s_rad": over("span_nm_rad") * damping_s,
        "current_saturation_a": servo["current_limit_a"],
        "coulomb_friction_nm": servo["coulomb_friction_nm"],
        "viscous_friction_nm_s_rad": servo["viscous_friction_nm_s_rad"],
        "stribeck_friction_nm": servo["coulomb_friction_nm"],
        "stiction_nm": servo["coulomb_friction_nm"],
        "load_dependent_friction": servo["load_friction"],
        "cogging_nm": servo["torque_limit_nm"],
        "cogging_cosine_nm": servo["torque_limit_nm"],
        "joint_elasticity_rad_nm": 1 / inertia,
        "plate_inertia_kg_m2": inertia,
        "gear_damping_nm_s_rad": inertia,
        "backlash_torque_nm": servo["torque_limit_nm"],
        "unmodelled_payload_kg": max(payload, 0.1 * over("tip_mass_kg")),
        "load_offset_nm": servo["torque_limit_nm"],
        "aerodynamic_drag_nm": width * length**4,
        "current_bias_a": servo["current_limit_a"],
        "payload_prior_kg": payload,
        "payload_spread_kg": max(payload, 0.05),
        "current_noise_a": servo["current_limit_a"],
    }
    return ratios.get(name, 1.0)
