"""Values and motions that the tests of rigs share."""

import dataclasses

import msgspec
import numpy as np

from models.shared.catalogue import CATALOGUE
from models.shared.kinematics import rigid_tip_m

STRENGTH = {effect: 2 * row.size for effect, row in CATALOGUE.items()} | {
    # What acts late, or beyond a limit, needs more to show in a short run.
    "current_saturation": 9.3, "stiffness_hardening": 2.0, "pressure_leak": 0.5,
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
