"""Base joints of the rod: yoke and plate on one or two driven joints, with the rod's reaction.

Joint 1 turns about y, joint 2 about -x and moves with joint 1. Yoke and plate have equal inertia
about all axes; the plate's mass and the rod's first node are at one point above the axes, so that

    M_1 = 2 I + m h^2 cos(q_2)^2,   M_2 = I + m h^2

with centrifugal terms from Lagrange's equations and no coupling in the mass matrix.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np
from elastica.rod.cosserat_rod import CosseratRod

from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array


class BaseJoints:
    """Angles and rates of the joints, which move the stub of the rod."""

    def __init__(
        self, parameters: RigParameters, rod: CosseratRod, root_mass_kg: float, gravity_m_s2: Array
    ) -> None:
        p = parameters
        self._rod = rod
        self._height_m = p["link.base_offset_m"]
        self._heights_m = rod.position_collection[2, :2].copy()
        self._turn = 1.0, 0.0, 1.0, 0.0
        mass_kg = p["link.plate_mass_kg"] + root_mass_kg
        self._weight_n: list[float] = (mass_kg * gravity_m_s2).tolist()
        self._frame = p["link.frame_inertia_kg_m2"]
        self._point = mass_kg * self._height_m**2
        self.angle_rad, self.rate_rad_s = [0.0, 0.0], [0.0, 0.0]

    def move(self, step_s: float) -> None:
        """Advance the joint angles with their rates by a time."""
        self.angle_rad[0] += step_s * self.rate_rad_s[0]
        self.angle_rad[1] += step_s * self.rate_rad_s[1]

    def place_stub(self) -> None:
        """Set the pose of the rod's first element and its nodes."""
        rod = self._rod
        q1, q2 = self.angle_rad
        c1, s1, c2, s2 = self._turn = cos(q1), sin(q1), cos(q2), sin(q2)
        pose = np.array((c1, 0.0, -s1, -s1 * s2, c2, -c1 * s2, s1 * c2, s2, c1 * c2)).reshape(3, 3)
        rod.director_collection[:, :, 0] = pose
        rod.position_collection[:, :2] = pose[2, :, None] * self._heights_m

    @property
    def plate_rad_s(self) -> Array:
        """Rate of the plate about its axes x and y, shape (2, 1)."""
        return np.array([[-self.rate_rad_s[1]], [self.rate_rad_s[0] * self._turn[2]]])

    def place_stub_velocity(self) -> None:
        """Set the velocity of the rod's first nodes, which drag and stretch rate depend on."""
        (c1, s1, c2, s2), (w1, w2), height = self._turn, self.rate_rad_s, self._height_m
        along, up = height * w1 * c2, -height * w2 * s2
        self._rod.velocity_collection[:, :2] = np.array(
            [[c1 * along + s1 * up], [height * w2 * c2], [c1 * up - s1 * along]]
        )

    def accelerate(self, torque_nm: list[float], step_s: float) -> None:
        """Advance the rates by a time, with servo torques, weight and the rod's reaction."""
        rod, height, point = self._rod, self._height_m, self._point
        w1, w2 = self.rate_rad_s
        c1, s1, c2, s2 = self._turn
        reaction_n = rod.internal_forces[:, 1].tolist()
        fx, fy, fz = (r + w for r, w in zip(reaction_n, self._weight_n, strict=True))
        mx, my, mz = rod.internal_torques[:, 0].tolist()
        # The force in the frame of the plate acts on an arm along its axis.
        mx -= height * (-s1 * s2 * fx + c2 * fy - c1 * s2 * fz)
        my += height * (c1 * fx - s1 * fz)
        turn1 = torque_nm[0] + c2 * my + s2 * mz + 2.0 * point * c2 * s2 * w1 * w2
        self.rate_rad_s[0] = w1 + step_s * turn1 / (2.0 * self._frame + point * c2 * c2)
        if len(torque_nm) > 1:
            turn2 = torque_nm[1] - mx - point * c2 * s2 * w1 * w1
            self.rate_rad_s[1] = w2 + step_s * turn2 / (self._frame + point)
