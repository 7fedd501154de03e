"""Rig as the plant behind the emulated servos: the MuJoCo robot on which plants are identified.

It includes effects that no plant models, so a run tests the robot's prediction, through loop and
line, on a link that the robot does not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.motion import Motion
from firmware_py.link.link_description import STUDY_LINK
from hil.emulator.physics import RigSource
from models.rig.drawn import rig_named
from models.rig.protocol import TrialCase, build_rig, draw_variation
from models.rig.sensors import read_current

Array = NDArray[np.float64]


class RigPhysics:
    """Rig with the interface `hil.emulator.physics.Physics`.

    It settles at zero and then runs in its own fixed steps. Angle, current and tip belong to the
    same time, the start of the last completed step, at most two steps ago. The tip is the true one,
    without the errors of the motion capture.
    """

    def __init__(self, rig: RigSource, dof: int, payload_kg: float = 0.0) -> None:
        # No simulated study contains trial 0, so no plant was identified on its variation.
        parameters = rig_named(rig.rig).hide(rig.hidden)
        link = parameters.link or STUDY_LINK
        case = TrialCase(
            Motion(dof=dof), payload_kg, trial=0, seed=rig.seed,
            pressure_pa=link.pressure_pa if rig.pressure_pa is None else rig.pressure_pa,
            gravity=link.gravity.unit,
        )  # fmt: skip
        self._rng = case.rng()
        variation = draw_variation(parameters, case, self._rng)
        self.dof, self._parameters = dof, variation.parameters
        self._rig = build_rig(
            self._parameters, dof, payload_kg, variation.eccentricity_m, case.gravity
        )
        self.angle_rad, self._true_current_a = np.zeros(dof), np.zeros(dof)
        self.current_a = np.zeros(dof)
        self._until_s = self._parameters["world.settle_s"]
        self._run()
        self._rig.start_leak()

    @property
    def tip_m(self) -> Array:
        """Tip in the world frame, shape (3,)."""
        return np.asarray(self._rig.markers_m[self._parameters.layout.tip_row].mean(axis=0))

    def advance(self, goal_rad: Sequence[float], step_s: float) -> None:
        self._rig.send(np.asarray(goal_rad))
        self._until_s += step_s
        self._run()

    def _run(self) -> None:
        rig, due_s = self._rig, self._until_s + 1e-9
        while rig.time_s + rig.step_s <= due_s:
            self.angle_rad[:] = [s.encoder_rad for s in rig.servos]
            self._true_current_a[:] = [s.sampled_current_a for s in rig.servos]
            rig.step()  # afterwards the markers are those at the start of the step
        self.current_a[:] = read_current(self._parameters, self._true_current_a, self._rng)
        rig.check_link("--rig")


def rig_conditions(rig: RigSource) -> dict[str, Any]:
    """Return the trial conditions given by the rig's link: size, pressure, markers, gravity."""
    p = rig_named(rig.rig)
    pressure = {} if rig.pressure_pa is None else {"pressure_pa": rig.pressure_pa}
    if p.link is not None:
        return p.link.conditions() | pressure
    return {
        "base_offset_m": p["link.base_offset_m"],
        "link_length_m": p["link.length_m"],
        "link_width_m": p["link.width_m"],
        "pressure_pa": p["stiffness.pressure_pa"],
    } | pressure
