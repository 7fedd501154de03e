"""Interface of a rig to the study's protocol, and what its engines share."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from firmware_py.errors import InputError
from models.rig.forms import MarkerPlay
from models.rig.parameters import RigParameters
from models.rig.servo import RigServo
from models.shared.kinematics import Array

DOWN: Final = (0.0, 0.0, -1.0)
"""Direction of gravity for an upright robot."""

FOLDED_RAD: Final = 0.8
"""Bend of a hinge or section above which the link has folded and the trial is refused [assumed]."""

BENDING_RAD: Final = 0.3
"""Bend above which a link whose state diverges in the next period has folded [assumed]; a
simulation with too long a step diverges from small bends."""


class Load(NamedTuple):
    """Payload at the tip: its mass and the offset of its centre from the link's axis."""

    mass_kg: float
    offset_x_m: float
    offset_y_m: float


class Rig(ABC):
    """Simulated robot, at rest and upright at the start.

    An engine is a subclass with the constructor's arguments of `models.rig.protocol.build_rig`. It
    simulates the hidden effects by the parameters that `RigParameters.effects` names; servos and
    the play of the link's mount are here.

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
    def step(self) -> None:
        """Advance by one integration step."""

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


def tip_load(
    parameters: RigParameters, payload_kg: float, eccentricity_m: tuple[float, float]
) -> Load:
    """Payload with its eccentricity and the rig's offset of all payloads."""
    x_m, y_m = eccentricity_m
    share = parameters["link.payload_offset_share"]
    return Load(payload_kg, x_m + share * parameters["link.length_m"], y_m)


def gravity_m_s2(parameters: RigParameters, direction: tuple[float, float, float]) -> Array:
    """Gravity in the world frame; the length of `direction` does not matter."""
    unit = np.array(direction) / np.linalg.norm(direction)
    return np.asarray(unit * parameters["world.gravity_m_s2"])
