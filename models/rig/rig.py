"""A rig to the study's protocol, and what its engines share: servos, the link's play, refusals."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from firmware_py.core.errors import InputError
from models.rig.parameters import RigParameters
from models.rig.servo import RigServo
from models.shared.kinematics import Array

FOLDED_RAD: Final = 0.8
"""Bend of a hinge or section above which the link has folded and the trial is refused [assumed]."""

BENDING_RAD: Final = 0.3
"""Bend above which a link whose state diverges in the next period has folded [assumed]; a
simulation with too long a step diverges from small bends."""


class Load(NamedTuple):
    """What the link carries, and in which field: payload, offset of its centre, gravity (3,)."""

    payload_kg: float
    offset_x_m: float
    offset_y_m: float
    gravity_m_s2: Array


class MarkerPlay:
    """Choice `play` = "markers": play in the link's mount, which moves only the markers.

    The link leans by half of the play to the side that its torque pushes to. It moves from one side
    to the other within a small range of torque and a short time, at first from the middle.
    """

    def __init__(self, parameters: RigParameters, dof: int, step_s: float) -> None:
        p = parameters
        play = [p.of_joint(k + 1)["servo.backlash_rad"] for k in range(dof)]
        self._half_rad = 0.5 * np.array(play) * (p.structure.play == "markers")
        self.absent = not self._half_rad.any()
        self._torque_nm = p["servo.play_torque_nm"]
        self._gain = -math.expm1(-step_s / p["servo.play_time_s"])
        self.lean_rad = np.zeros(dof)

    def advance(self, torque_nm: Sequence[float]) -> None:
        """Advance by one step; `torque_nm` acts from the drives on the joints."""
        for k, torque in enumerate(torque_nm):
            side_rad = -self._half_rad[k] * math.tanh(torque / self._torque_nm)
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


class Rig(ABC):
    """Simulated robot, at rest and upright at the start.

    An engine is a subclass with the constructor's arguments `(parameters, dof, load)`. It simulates
    the hidden effects by the parameters that `RigParameters.effects` names; servos and the play of
    the link's mount are here.

    Parameters
    ----------
    parameters : RigParameters
        Structure and values.
    dof : int
        Driven joints, 1 or 2.
    servo_step_s : float
        Step with which the engine advances the servos.

    Attributes
    ----------
    step_s : float
        Integration step in s, an integer fraction of the control period.
    servos : list of RigServo
        One per driven joint.
    """

    def __init__(self, parameters: RigParameters, dof: int, servo_step_s: float) -> None:
        p = parameters
        self.step_s = p["world.step_s"]
        self.servos = [RigServo(p.of_joint(k + 1), servo_step_s) for k in range(dof)]
        self._play = MarkerPlay(p, dof, self.step_s)
        self._steps, self._bend_rad, self._leak_from_s = 0, 0.0, math.inf

    @abstractmethod
    def advance(self) -> None:
        """Advance link, joints and servos by one integration step."""

    @property
    @abstractmethod
    def joint_rad(self) -> Sequence[float]:
        """Angles of the driven joints."""

    @property
    @abstractmethod
    def link_markers_m(self) -> Array:
        """True markers of a link without play in its mount; described by `markers_m`."""

    @property
    @abstractmethod
    def largest_bend_rad(self) -> float:
        """Largest bend of a hinge or section now; not finite if the simulation has diverged."""

    def step(self) -> None:
        """Advance by one integration step."""
        self.advance()
        if not self._play.absent:
            self._play.advance([servo.gear_nm for servo in self.servos])
        self._steps += 1

    @property
    def time_s(self) -> float:
        """Time since the start in s."""
        return self._steps * self.step_s

    @property
    def leaking_s(self) -> float:
        """Time since the start of the pressure leak, 0 before it."""
        return max(self.time_s - self._leak_from_s, 0.0)

    @property
    def markers_m(self) -> Array:
        """True markers in the world frame, shape (markers, 3), at the start of the last step.

        In the order m01, m02, … of `docs/trials.md`. The next step may change the array.
        """
        markers_m = self.link_markers_m
        return markers_m if self._play.absent else self._play.shown_m(markers_m, self.joint_rad)

    def start_leak(self) -> None:
        """Start the pressure leak, at the start of the recorded run."""
        self._leak_from_s = self.time_s

    def send(self, goal_rad: Array) -> None:
        """Send goals in rad, shape (dof,), to the servos."""
        for servo, goal in zip(self.servos, goal_rad, strict=True):
            servo.send(float(goal), self.time_s)

    def check_link(self, where: str) -> None:
        """Refuse a link that folds, or an unstable simulation; call it once per control period."""
        before_rad, self._bend_rad = self._bend_rad, self.largest_bend_rad
        if self._bend_rad < FOLDED_RAD:
            return
        if before_rad > BENDING_RAD:
            raise InputError(
                where, f"the link folds {self.time_s:.1f} s after power-up",
                "choose a smaller payload, amplitude or strength, or a longer period",
            )  # fmt: skip
        raise InputError(
            where, f"the simulation is unstable {self.time_s:.1f} s after power-up: its step of "
            f"{self.step_s:g} s is too long for parts as light and stiff as these",
            "check masses, stiffness, gear and rotor inertia of link or rig",
        )  # fmt: skip
