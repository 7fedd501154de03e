"""Rig on MuJoCo: servos, link of hinges and bending law, stepped together."""

from __future__ import annotations

from typing import Final

import casadi as ca
import mujoco
import numpy as np

from models.rig.forms.marker_play import MarkerPlay
from models.rig.hinged.bending_law import BendLaw
from models.rig.hinged.in_place_function import InPlaceFunction
from models.rig.hinged.mujoco_link import Load, build_mujoco_link
from models.rig.rig_parameters import RigParameters
from models.rig.rig_servo import RigServo
from models.rig.trial_case import DOWN, LinkState, state_of_link
from models.shared.kinematics import Array

__all__ = ["MujocoRig"]

UNSTABLE_WARNINGS: Final = (
    mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)  # fmt: skip
"""Warnings with which MuJoCo resets the state."""
if mujoco.get_mju_user_warning() is None:  # else each goes to a file in the working directory
    mujoco.set_mju_user_warning(lambda message: None)


class MujocoRig:
    """`models.rig.rig.Rig` on MuJoCo; `models.rig.rig.build_rig` describes the arguments."""

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
        self.bending_law = BendLaw(p, self.step_s)
        load = Load(
            payload_kg,
            eccentricity_m[0] + p["link.payload_offset_share"] * p["link.length_m"],
            eccentricity_m[1],
        )
        down = np.array(gravity) / np.linalg.norm(gravity) * p["world.gravity_m_s2"]
        self.link = build_mujoco_link(p, dof, load, down, self.bending_law.stiffness_nm_rad)
        self.data = mujoco.MjData(self.link.model)
        mujoco.mj_forward(self.link.model, self.data)
        self.servos = [RigServo(p.of_joint(k + 1), self.step_s) for k in range(dof)]
        self._play = MarkerPlay(p, dof, self.step_s)
        self._dragged = p["world.drag_nm"] != 0.0
        # MuJoCo's arrays stay in place: views of them save a look-up and a copy per step.
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._applied_nm = self.data.qfrc_applied
        pieces = slice(self.link.bodies[0], self.link.bodies[-1] + 1)  # bodies are consecutive
        self._body_centres = self.data.xipos[pieces]
        self._centres = self._body_centres.copy()
        self._set_drag = InPlaceFunction(
            self._drag(p["world.drag_nm"]),
            [self._body_centres, self._centres],
            [self.data.xfrc_applied[pieces]],
        )
        self._drives = list(zip(self.servos, self.link.joints.tolist(), strict=True))
        self._steps, self._last_bend_rad = 0, 0.0
        self._leak_from_s = np.inf

    @property
    def time_s(self) -> float:
        """Time since the start in s."""
        return self._steps * self.step_s

    @property
    def markers_m(self) -> Array:
        """True markers in the world frame, shape (markers, 3), at the start of the last step.

        MuJoCo updates sites before it moves the bodies. The result may be a view that the next step
        changes.
        """
        markers_m = np.asarray(self.data.site_xpos)
        if self._play.absent:
            return markers_m
        return self._play.shown_m(markers_m, self.data.qpos[self.link.joints])

    def look(self) -> LinkState:
        """Whether the link is intact, has folded, or its simulation has become unstable.

        MuJoCo counts states that are not finite and restarts from zero after each.
        """
        reset = any(self.data.warning[w].number for w in UNSTABLE_WARNINGS)
        bend_rad = np.nan if reset else float(np.max(np.abs(self.data.qpos[self.link.hinges])))
        state = state_of_link(bend_rad, self._last_bend_rad)
        self._last_bend_rad = bend_rad
        return state

    def start_leak(self) -> None:
        """Start the pressure leak, at the start of the recorded run."""
        self._leak_from_s = self.time_s

    def send(self, goal_rad: Array) -> None:
        """Send goals in rad, shape (dof,), to the servos."""
        for servo, goal in zip(self.servos, goal_rad, strict=True):
            servo.send(float(goal), self.time_s)

    def step(self) -> None:
        """Advance by one integration step."""
        time_s, hinges = self.time_s, self.link.hinges
        qpos, qvel, applied_nm = self._qpos, self._qvel, self._applied_nm
        for servo, joint in self._drives:
            torque = servo.step(time_s, float(qpos[joint]), float(qvel[joint]))
            applied_nm[joint] = torque + servo.load_nm
        leaking_s = max(time_s - self._leak_from_s, 0.0)
        applied_nm.put(hinges, self.bending_law.torque_nm(qpos.take(hinges), leaking_s))
        if self._dragged:
            self._set_drag()
            np.copyto(self._centres, self._body_centres)
        if not self._play.absent:
            self._play.advance([servo.gear_nm for servo in self.servos])
        mujoco.mj_step(self.link.model, self.data)
        self._steps += 1

    def _drag(self, drag_nm: float) -> ca.Function:
        """Function (centres of the pieces now, a step earlier) -> their wrenches, shape (6, n)."""
        coefficients = ca.DM(drag_nm * self._drag_coefficients()).T
        now_m, before_m = (ca.SX.sym(name, 3, coefficients.numel()) for name in ("now", "before"))
        velocity = (now_m - before_m) / self.step_s
        speed = ca.sqrt(ca.sum1(velocity**2))
        force_n = -ca.repmat(coefficients * speed, 3, 1) * velocity
        wrench = ca.densify(ca.vertcat(force_n, ca.SX.zeros(3, coefficients.numel())))
        return ca.Function("drag", [now_m, before_m], [wrench])

    def _drag_coefficients(self) -> Array:
        """Force per speed squared of each piece, such that 1 rad/s about joint 1 gives 1 N·m."""
        height = self.data.xipos[self.link.bodies, 2]
        area = self.link.model.body_mass[self.link.bodies]  # uniform: as the mass
        return np.asarray(area / np.sum(area * height**3))
