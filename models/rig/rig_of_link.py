"""Rig of a described link: the study's parameters, scaled by size, pressure and servo."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import msgspec

from firmware_py.bus.servo_models import model_named
from firmware_py.link.link_description import STUDY_LINK, LinkDescription
from models.rig.rig_parameters import RigParameters, read_parameters
from models.shared.link_scale import LinkScale

__all__ = ["rig_of_link"]


def rig_of_link(link: LinkDescription, path: Path) -> RigParameters:
    own = read_parameters()
    ratios = _ratios(LinkScale(link))
    entries = {
        name: msgspec.structs.replace(
            entry, value=entry.value * ratios.get(name, 1.0),
            minimum=entry.minimum * ratios.get(name, 1.0),
            maximum=entry.maximum * ratios.get(name, 1.0),
        )
        for name, entry in own.entries.items()
    }  # fmt: skip
    rig = replace(own, entries=entries, path=path, link=link)
    return rig.changed(**_values(link, own))


def _values(link: LinkDescription, own: RigParameters) -> dict[str, float]:
    """Values that the description states directly."""
    model, preset = model_named(link.servo.model), link.preset
    scale, study = LinkScale(link), LinkScale(STUDY_LINK)
    # The rig adds p h² to the wall's shear; for a round section that is too much.
    excess_n = link.pressure_pa * (link.width_m**2 - scale.area_m2)
    wall = own["stiffness.wall_shear_n"] * (scale.wall_shear_n / study.wall_shear_n)
    return {
        "link.length_m": link.length_m,
        "link.width_m": link.width_m,
        "link.base_offset_m": link.base_offset_m,
        "stiffness.pressure_pa": link.pressure_pa,
        "stiffness.wall_shear_n": wall - excess_n,
        "servo.profile_velocity_rad_s": min(
            own["servo.profile_velocity_rad_s"], preset.speed_limit_rad_s
        ),
        "sensor.pulses_per_turn": float(model.pulses_per_turn),
        "sensor.current_step_a": model.current_a_per_lsb,
        "world.gravity_m_s2": link.gravity.size_m_s2,
    }


def _ratios(scale: LinkScale) -> dict[str, float]:
    """Factors on the study's values and bounds, by parameter."""
    servo, over = scale.servo_ratios, scale.over_study
    width = scale.link.width_m / STUDY_LINK.width_m
    length = scale.link.length_m / STUDY_LINK.length_m
    pressure = over("pressure_ratio")  # the rig already multiplies by it
    torque, inertia = servo["torque_limit_nm"], servo["rotor_inertia_kg_m2"]
    coulomb, current = servo["coulomb_friction_nm"], servo["current_limit_a"]
    return {
        "link.mass_kg": over("mass_kg"),
        "link.tip_mass_kg": over("tip_mass_kg"),
        "link.payload_size_m": width,
        "link.plate_mass_kg": over("plate_m2"),
        "link.yoke_mass_kg": servo["mass_kg"],
        "link.frame_inertia_kg_m2": over("plate_m2") ** 2,
        "stiffness.bending_n_m2": over("bending_n_m2") / pressure,
        "stiffness.root_nm_rad": over("root_nm_rad") / pressure,
        "stiffness.root_limit_nm": over("limit_moment_nm") / pressure,
        "stiffness.span_limit_nm": over("limit_moment_nm") / pressure,
        "stiffness.damping_s": 1 / over("first_mode_rad_s"),
        "servo.speed_limit_rad_s": servo["speed_limit_rad_s"],
        "servo.inertia_kg_m2": inertia,
        "servo.torque_constant_nm_a": servo["torque_constant_nm_a"],
        "servo.current_limit_a": current,
        "servo.current_limit_reduction_a": current,
        "servo.coulomb_friction_nm": coulomb,
        "servo.viscous_friction_nm_s_rad": servo["viscous_friction_nm_s_rad"],
        "servo.stribeck_friction_nm": coulomb,
        "servo.load_friction_share": servo["load_friction"],
        "servo.breakaway_friction_nm": coulomb,
        "servo.cogging_nm": torque,
        # Presliding over the same angle, with the same damping ratio against the rotor.
        "servo.bristle_stiffness_nm_rad": coulomb,
        "servo.bristle_damping_nm_s_rad": math.sqrt(coulomb * inertia),
        "servo.backlash_rad": servo["backlash_rad"],
        "servo.play_torque_nm": torque,
        # The rotor swings on the gear at the same frequency.
        "servo.gear_compliance_rad_nm": 1 / inertia,
        "servo.gear_damping_nm_s_rad": inertia,
        "servo.load_offset_nm": torque,
        "sensor.current_noise_a": current,
        "sensor.current_bias_a": current,
        "variation.eccentricity_m": width,
        "world.drag_nm": width * length**4,
    }
