"""Rig behind the emulated servos: the MuJoCo robot on which the plant was identified.

Hidden effects included, so that the robot's own prediction is compared with a link that it does not
know, through loop and line.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.motion import Motion
from hil.emulator.physics import RigSource
from models.rig.drawn_rig import rig_named
from models.rig.rig import build_rig
from models.rig.rig_parameters import read_parameters
from models.rig.sensors import read_current
from models.rig.study_protocol import draw_variation
from models.rig.trial_case import TrialCase

Array = NDArray[np.float64]

_TIP_ROW = slice(12, 16)


class RigPhysics:
    """Rig as `hil.emulator.physics.Physics`.

    It settles at zero and then runs in its own steps: angle, current and tip belong to one moment,
    the start of the last whole step, which is at most two steps ago. The tip is the true one; what
    is hidden in the motion capture does not change it.

    Parameters
    ----------
    rig : RigSource
        Rig, hidden effects and seed.
    dof : int
        Number of joints.
    payload_kg : float
        Declared mass at the tip.

    Raises
    ------
    InputError
        If an effect cannot be hidden, or, from `advance`, if the link folds.
    """

    def __init__(self, rig: RigSource, dof: int, payload_kg: float = 0.0) -> None:
        # Trial 0 is one that no `simulate` runs: its variation is new to every plant.
        case = TrialCase(Motion(dof=dof), payload_kg, trial=0, seed=rig.seed)
        self._rng = case.rng()
        variation = draw_variation(rig_named(rig.rig).hide(rig.hidden), case, self._rng)
        self.dof, self._parameters = dof, variation.parameters
        self._rig = build_rig(self._parameters, dof, payload_kg, variation.eccentricity_m)
        self.angle_rad, self._true_current_a = np.zeros(dof), np.zeros(dof)
        self.current_a = np.zeros(dof)
        self._until_s = self._parameters["world.settle_s"]
        self._run()
        self._rig.start_leak()

    @property
    def tip_m(self) -> Array:
        """End effector in the world frame, shape (3,)."""
        return np.asarray(self._rig.markers_m[_TIP_ROW].mean(axis=0))

    def advance(self, goal_rad: Sequence[float], step_s: float) -> None:
        """See `hil.emulator.physics.Physics.advance`."""
        self._rig.send(np.asarray(goal_rad))
        self._until_s += step_s
        self._run()

    def _run(self) -> None:
        rig, due_s = self._rig, self._until_s + 1e-9
        while rig.time_s + rig.step_s <= due_s:
            self.angle_rad[:] = [s.encoder_rad for s in rig.servos]
            self._true_current_a[:] = [s.sampled_current_a for s in rig.servos]
            rig.step()  # leaves the markers of its start behind
        self.current_a[:] = read_current(self._parameters, self._true_current_a, self._rng)
        if rig.folded:
            raise InputError(
                "--hide", f"the link folds {rig.time_s:.1f} s after power-up",
                "choose a smaller payload, amplitude or strength",
            )  # fmt: skip


def rig_geometry() -> dict[str, float]:
    """The link's base_offset_m, link_length_m and link_width_m."""
    p = read_parameters()
    return {
        "base_offset_m": p["link.base_offset_m"],
        "link_length_m": p["link.length_m"],
        "link_width_m": p["link.width_m"],
    }
