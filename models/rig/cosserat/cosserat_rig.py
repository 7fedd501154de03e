"""Rig on a Cosserat rod: servos, base joints and rod, stepped together."""

from __future__ import annotations

from typing import Final

import numpy as np

from firmware_py.errors import InputError
from models.rig.cosserat.base_joints import BaseJoints
from models.rig.cosserat.rod_link import RodLink, TipLoad
from models.rig.forms.marker_play import MarkerPlay
from models.rig.rig_parameters import RigParameters
from models.rig.rig_servo import RigServo
from models.rig.rig_structure import DEFAULT_STRUCTURE
from models.rig.trial_case import DOWN, LinkState, state_of_link
from models.shared.kinematics import Array

__all__ = ["CosseratRig"]

SECTIONS: Final = 8
"""Sections of the span; halving their length shifts the first mode by less than 1 %."""

HINGED_CHOICES: Final = ("hinges", "limit", "hysteresis", "creep")
"""Choices of a structure that apply to the MuJoCo link only; the rod has its own forms."""


class CosseratRig:
    """`models.rig.rig.Rig` on PyElastica; `models.rig.rig.build_rig` describes the arguments.

    Rod, joints and servos advance by the position Verlet method, in substeps that are stable for
    the stiffest section. Section law, drag and leak are updated once per step.
    """

    def __init__(
        self,
        parameters: RigParameters,
        dof: int,
        payload_kg: float,
        eccentricity_m: tuple[float, float] = (0.0, 0.0),
        gravity: tuple[float, float, float] = DOWN,
        sections: int = SECTIONS,
    ) -> None:
        p = parameters
        for choice in HINGED_CHOICES:
            chosen = getattr(p.structure, choice)
            if chosen != getattr(DEFAULT_STRUCTURE, choice):
                raise InputError(
                    p.path, f"chooses {choice} = {chosen!r}, which is not the rod's", "leave it out"
                )
        self.step_s = p["world.step_s"]
        down = np.array(gravity) / np.linalg.norm(gravity) * p["world.gravity_m_s2"]
        load = TipLoad(
            payload_kg,
            eccentricity_m[0] + p["link.payload_offset_share"] * p["link.length_m"],
            eccentricity_m[1],
        )
        self.link = RodLink(p, load, down, sections)
        self.joints = BaseJoints(p, self.link.rod, self.link.root_mass_kg, down)
        self._substep_s = self.step_s / self.link.substeps
        self.servos = [RigServo(p.of_joint(k + 1), self._substep_s) for k in range(dof)]
        self._play = MarkerPlay(p, dof, self.step_s)
        self._shown_rad = [0.0] * dof
        self._steps, self._last_bend_rad = 0, 0.0
        self._leak_from_s = np.inf

    @property
    def time_s(self) -> float:
        """Time since the start in s."""
        return self._steps * self.step_s

    @property
    def markers_m(self) -> Array:
        """True markers in the world frame, shape (markers, 3), at the start of the last step."""
        if self._play.absent:
            return self.link.markers_m
        return self._play.shown_m(self.link.markers_m, self._shown_rad)

    def look(self) -> LinkState:
        """Whether the link is intact, has folded, or its simulation has become unstable."""
        bend_rad = float(np.max(np.abs(self.link.bend_rad)))
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
        link, joints, servos = self.link, self.joints, self.servos
        start_s, substep_s, last = self.time_s, self._substep_s, self.link.substeps - 1
        link.begin_step(joints.plate_rad_s, max(start_s - self._leak_from_s, 0.0))
        if not self._play.absent:
            self._play.advance([servo.gear_nm for servo in servos])
            self._shown_rad = joints.angle_rad[: len(servos)]
        splits, part_s = link.splits, substep_s / link.splits
        link.move(0.5 * part_s)
        joints.move(0.5 * part_s)
        for k in range(last + 1):
            time_s = start_s + k * substep_s
            torque_nm = [
                servo.step(time_s, angle, rate) + servo.load_nm
                for servo, angle, rate in zip(
                    servos, joints.angle_rad, joints.rate_rad_s, strict=False
                )
            ]
            for part in range(splits):
                joints.place_stub()
                link.accelerate(part_s)
                joints.accelerate(torque_nm, part_s)
                onward_s = part_s if k < last or part < splits - 1 else 0.5 * part_s
                link.move(onward_s)
                joints.move(onward_s)
        joints.place_stub()
        joints.place_stub_velocity()
        self._steps += 1
