"""Play in the link's mount, which moves only the markers.

The link leans by half of the play to the side that its torque pushes to. It moves from one side to
the other within a small range of torque and a short time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array


class MarkerPlay:
    """Lean of the link in its mount, at first in the middle; zero if the play is in the gear."""

    def __init__(self, parameters: RigParameters, dof: int, step_s: float) -> None:
        p, in_markers = parameters, parameters.structure.play == "markers"
        own_rad = [p.of_joint(k + 1)["servo.backlash_rad"] for k in range(dof)]
        self._half_rad = [0.5 * width if in_markers else 0.0 for width in own_rad]
        self.absent = not any(self._half_rad)
        self._torque_nm = p["servo.play_torque_nm"]
        self._gain = -math.expm1(-step_s / p["servo.play_time_s"])
        self.lean_rad = np.zeros(dof)

    def advance(self, torque_nm: Sequence[float]) -> None:
        """Advance by one step; `torque_nm` acts from the drives on the joints."""
        for k, (torque, half_rad) in enumerate(zip(torque_nm, self._half_rad, strict=True)):
            side_rad = -half_rad * math.tanh(torque / self._torque_nm)
            self.lean_rad[k] += self._gain * (side_rad - self.lean_rad[k])

    def shown_m(self, markers_m: Array, joint_rad: Sequence[float]) -> Array:
        """Markers on the leaning link, shape (markers, 3)."""
        cos, sin = math.cos(joint_rad[0]), math.sin(joint_rad[0])
        # Rotation vector; the second axis, -x, is carried by the first joint.
        x, y, z = 0.0, self.lean_rad[0], 0.0
        if len(self.lean_rad) == 2:
            x, z = -cos * self.lean_rad[1], sin * self.lean_rad[1]
        turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.asarray(markers_m + markers_m @ (turn + 0.5 * turn @ turn).T)
