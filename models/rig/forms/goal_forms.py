"""Set-point of the servo between two goals: held, interpolated or profiled.

A held goal becomes the set-point at once. An interpolating servo reaches the goal on a line, one
control period after it took effect. A profiling servo moves its set-point with limited velocity and
acceleration (trapezoidal profile, e-Manual of ROBOTIS, "Profile Velocity"). It plans again from the
current set-point when the next goal arrives.
"""

from __future__ import annotations

import math
from typing import Protocol

from firmware_py.signals import PERIOD_S
from models.rig.rig_parameters import RigParameters


class GoalForm(Protocol):
    """Set-point of one servo, at rest at zero."""

    # Rate of the set-point in the last step; for a held goal, its last change per period
    rate_rad_s: float

    def take(self, goal_rad: float) -> None:
        """Set the goal that takes effect now."""
        ...

    def advance(self) -> float:
        """Advance by one step and return the set-point in rad."""
        ...


class HeldGoal:
    """Set-point that jumps to each goal."""

    def __init__(self, step_s: float) -> None:
        self._steps = max(round(PERIOD_S / step_s), 1)
        self._goal_rad = self._change_rad = self.rate_rad_s = 0.0
        self._left = 0

    def take(self, goal_rad: float) -> None:
        self._change_rad, self._left = goal_rad - self._goal_rad, self._steps
        self._goal_rad = goal_rad

    def advance(self) -> float:
        self.rate_rad_s = self._change_rad / PERIOD_S if self._left else 0.0
        self._left = max(self._left - 1, 0)
        return self._goal_rad


class InterpolatedGoal:
    """Set-point that moves to each goal on a line."""

    def __init__(self, step_s: float) -> None:
        self._steps = max(round(PERIOD_S / step_s), 1)
        self._step_s = step_s
        self._goal_rad = self._setpoint_rad = self._per_step_rad = self.rate_rad_s = 0.0
        self._left = 0

    def take(self, goal_rad: float) -> None:
        self._goal_rad, self._left = goal_rad, self._steps
        self._per_step_rad = (goal_rad - self._setpoint_rad) / self._steps

    def advance(self) -> float:
        self.rate_rad_s = self._per_step_rad / self._step_s if self._left else 0.0
        if self._left:
            self._left -= 1
            self._setpoint_rad = self._goal_rad - self._left * self._per_step_rad
        return self._setpoint_rad


class ProfiledGoal:
    """Set-point that moves with limited velocity and acceleration."""

    def __init__(self, step_s: float, velocity_rad_s: float, acceleration_rad_s2: float) -> None:
        self._step_s = step_s
        self._fastest = velocity_rad_s
        self._gain = acceleration_rad_s2 * step_s  # of velocity in a step
        self._goal_rad = self._setpoint_rad = self.rate_rad_s = 0.0

    def take(self, goal_rad: float) -> None:
        self._goal_rad = goal_rad

    def advance(self) -> float:
        left = self._goal_rad - self._setpoint_rad
        # With n steps of braking from the velocity n a h, the distance is a h^2 n (n + 1) / 2.
        steps = math.sqrt(0.25 + 2.0 * abs(left) / (self._gain * self._step_s)) - 0.5
        speed = min(self._gain * steps, abs(left) / self._step_s, self._fastest)
        wanted = math.copysign(speed, left)
        slowest, fastest = self.rate_rad_s - self._gain, self.rate_rad_s + self._gain
        self.rate_rad_s = min(max(wanted, slowest), fastest)
        self._setpoint_rad += self._step_s * self.rate_rad_s
        return self._setpoint_rad


def goal_form(parameters: RigParameters, step_s: float) -> GoalForm:
    """Build the form that the structure names."""
    p = parameters
    match p.structure.goal:
        case "held":
            return HeldGoal(step_s)
        case "interpolated":
            return InterpolatedGoal(step_s)
        case "profile":
            velocity, acceleration = (
                p["servo.profile_velocity_rad_s"], p["servo.profile_acceleration_rad_s2"],
            )  # fmt: skip
            return ProfiledGoal(step_s, velocity, acceleration)
