"""The robot of the laboratory, ready to step: servos, chain and bending law together."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from models.rig.bending_law import BendLaw
from models.rig.mujoco_link import Load, build_mujoco_link
from models.rig.rig_parameters import RigParameters
from models.rig.rig_servo import RigServo
from models.rig.trial_case import DOWN
from models.shared.kinematics import Array

FOLDED_RAD: Final = 0.8
"""Bend of a hinge beyond which the link has folded and the run is no trial."""


class Rig:
    """The robot as it stands on the bench, at rest and upright.

    Parameters
    ----------
    parameters : RigParameters
        With everything that is hidden or varied already in them.
    dof : int
        Number of driven joints.
    payload_kg : float
        Declared payload.
    eccentricity_m : tuple of float
        Where the payload's centre lies off the axis, towards +x and +y.
    gravity : sequence of float, shape (3,)
        Direction of gravity in the world frame; its length does not matter.

    Attributes
    ----------
    servos : list of RigServo
        One per driven joint.
    law : BendLaw
        Bending torque of the link.
    data : mujoco.MjData
        State of the chain.
    time_s : float
        Since the start.
    """

    def __init__(
        self,
        parameters: RigParameters,
        dof: int,
        payload_kg: float,
        eccentricity_m: tuple[float, float] = (0.0, 0.0),
        gravity: tuple[float, float, float] = DOWN,
    ) -> None:
        p = parameters
        self.step_s = p["world.step_s"]
        self.law = BendLaw(p, self.step_s)
        load = Load(
            payload_kg,
            eccentricity_m[0] + p["link.payload_offset_share"] * p["link.length_m"],
            eccentricity_m[1],
        )
        down = np.array(gravity) / np.linalg.norm(gravity) * p["world.gravity_m_s2"]
        self.chain = build_mujoco_link(p, dof, load, down, self.law.stiffness_nm_rad)
        self.data = mujoco.MjData(self.chain.model)
        mujoco.mj_forward(self.chain.model, self.data)
        self.servos = [RigServo(p, self.step_s) for _ in range(dof)]
        self._load_nm = p["servo.load_offset_nm"]
        self._drag = p["world.drag_nm"] * self._drag_shares()
        self._dragged = bool(self._drag.any())
        self._centres = self.data.xipos[self.chain.bodies]
        self._drives = list(zip(self.servos, self.chain.joints.tolist(), strict=True))
        self._steps = 0
        self._leak_from_s = np.inf

    @property
    def time_s(self) -> float:
        """Time since the start."""
        return self._steps * self.step_s

    @property
    def markers_m(self) -> Array:
        """True markers in the world frame, shape (16, 3), as the last step found them.

        MuJoCo places what is fixed to the bodies before it moves them: the markers belong to the
        start of the last step. This is a view that the next step changes.
        """
        return np.asarray(self.data.site_xpos)

    @property
    def folded(self) -> bool:
        """Whether the link has folded, or its state is no number any more."""
        return not np.max(np.abs(self.data.qpos[self.chain.hinges])) < FOLDED_RAD

    def start_leak(self) -> None:
        """Let the pressure leak from now on (it holds until the recorded run begins)."""
        self._leak_from_s = self.time_s

    def send(self, goal_rad: Array) -> None:
        """Send goals of shape (dof,) to the servos."""
        for servo, goal in zip(self.servos, goal_rad, strict=True):
            servo.send(float(goal), self.time_s)

    def step(self) -> None:
        """Advance by one integration step."""
        data, chain, time_s = self.data, self.chain, self.time_s
        qpos, qvel, applied_nm = data.qpos, data.qvel, data.qfrc_applied
        for servo, joint in self._drives:
            torque = servo.step(time_s, float(qpos[joint]), float(qvel[joint]))
            applied_nm[joint] = torque + self._load_nm
        leaking_s = max(time_s - self._leak_from_s, 0.0)
        applied_nm[chain.hinges] = self.law.torque_nm(qpos.take(chain.hinges), leaking_s)
        if self._dragged:
            self._apply_drag()
        mujoco.mj_step(chain.model, data)
        self._steps += 1

    def _apply_drag(self) -> None:
        """Quadratic drag on the centre of every piece of the link."""
        centres = self.data.xipos.take(self.chain.bodies, axis=0)
        velocity = (centres - self._centres) / self.step_s
        square = velocity * velocity
        speed = np.sqrt(square[:, 0] + square[:, 1] + square[:, 2])
        self.data.xfrc_applied[self.chain.bodies, :3] = -(self._drag * speed)[:, None] * velocity
        self._centres = centres

    def _drag_shares(self) -> Array:
        """Force per speed squared of each piece, so that 1 rad/s about joint 1 gives 1 N·m."""
        height = self.data.xipos[self.chain.bodies, 2]
        area = self.chain.model.body_mass[self.chain.bodies]  # even mass: as long as heavy
        return np.asarray(area / np.sum(area * height**3))
