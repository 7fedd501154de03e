"""Values and motions that the tests of rigs share."""

import dataclasses

import msgspec
import numpy as np

from models.shared.kinematics import rigid_tip_m

STRENGTH = {
    "coulomb_friction": 3.0, "viscous_friction": 5.0, "stribeck_friction": 4.0,
    "load_dependent_friction": 0.2, "backlash": 0.01, "joint_elasticity": 1e-3,
    "dead_time": 0.03, "position_gain_change": 0.2, "current_saturation": 9.3,
    "torque_constant_drift": 0.2, "unmodelled_payload": 0.3, "payload_offset": 0.05,
    "prebend": 0.05,
    "directional_stiffness": 0.3, "stiffness_softening": 0.4, "stiffness_hardening": 2.0,
    "pressure_leak": 0.5, "hysteresis": 0.4, "creep": 0.4, "aerodynamic_drag": 2.0,
    "cross_axis_coupling": 0.2, "encoder_offset": 0.02, "load_offset": 4.0, "current_bias": 0.2,
    "current_scale": 0.1, "marker_frame_tilt": 0.02, "sync_offset": 0.03,
    "sensor_lag": 0.05, "encoder_ripple": 0.01, "cogging": 3.0, "marker_scale": 0.02,
    "stiction": 4.0,
}  # fmt: skip
"""Strength of each hidden effect that shows on a rig."""

NO_MEMORY = {"memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0}
EVEN = {"stiffness.directional_share": 0.0, "stiffness.prebend_rad": 0.0}
UNLIMITED = {"stiffness.root_limit_nm": 1e6, "stiffness.span_limit_nm": 1e6}
ELASTIC = {**NO_MEMORY, **EVEN, **UNLIMITED, "world.drag_nm": 0.0}
QUICK = {"world.settle_s": 0.3, "world.pause_s": 0.3}
"""Short pauses, for tests that need no rest afterwards."""


def with_structure(parameters, **choices):
    structure = msgspec.structs.replace(parameters.structure, **choices)
    return dataclasses.replace(parameters, structure=structure)


def run(rig, seconds, goal_rad=None):
    """Advance a rig; return its deflection along x in m after every step."""
    if goal_rad is not None:
        rig.send(np.asarray(goal_rad))
    deflection = []
    for _ in range(round(seconds / rig.step_s)):
        rig.step()
        deflection.append(deflection_m(rig)[0])
    return np.array(deflection)


def tip_m(rig):
    return rig.markers_m[12:].mean(axis=0)


def deflection_m(rig):
    """Tip against a rigid link on the same joints."""
    return tip_m(rig) - rigid_tip_m(np.array([rig.joint_rad]), 0.06, 0.95)[0]
