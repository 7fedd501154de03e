"""Limits of goals and measurements, and the checks against them.

A limit is the last permitted value. `firmware_py.safety.supervisor` decides what follows from a
violation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import msgspec

__all__ = ["Limits"]

_ROUNDING: Final = 1.0 + 1e-9
"""Tolerance for the rounding of a difference quotient of goals at the limit."""


class Limits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits of the robot (table `[limits]` of robot.toml), the same for every joint."""

    # Range of the goals; measured angles may exceed it by `following_error_rad`
    angle_rad: tuple[float, float] = (-0.6, 0.6)
    # Largest rate and acceleration of the goals. The study's motion starts at full speed: 0.76
    # rad/s within one period.
    rate_rad_s: float = 2.0
    acceleration_rad_s2: float = 60.0
    current_a: float = 8.0  # Largest magnitude of the motor current
    # Largest distance of a measured angle from the goal sent before it
    following_error_rad: float = 0.2
    # Largest change of a measured angle between samples; more is an encoder fault
    jump_rad: float = 0.1
    # Box in the world frame for the predicted tip
    tip_min_m: tuple[float, float, float] = (-1.2, -1.2, 0.0)
    tip_max_m: tuple[float, float, float] = (1.2, 1.2, 1.3)
    persistence_ticks: int = 3  # Samples in a row that must violate a limit before the robot stops
    # Ticks in a row without fresh data, or slots missed in a row, at which the robot stops
    stale_ticks: int = 3
    # Largest count of missed slots, reduced by one with each tick that is on time; beyond it the
    # loop is too slow for its period and the robot stops
    missed_slots: int = 12
    blend_s: float = 1.0  # Shortest duration of a blend into the motion
    stop_deceleration_rad_s2: float = 6.0  # Deceleration of the goals in a controlled stop
    hold_s: float = 0.5  # Time for which the last goal is held before the torque goes off

    def sample_violation(
        self,
        angle: Sequence[float],
        current: Sequence[float],
        tip: Sequence[float],
        di: float,
        *,
        goal: Sequence[float],
        angle_before: Sequence[float],
    ) -> str:
        """Return the first limit that a measurement violates, as a sentence; empty for none.

        `angle`, `current`: measured angles in rad and currents in A, one per joint.
        `goal`, `angle_before`: goals sent before the sample, and angles of the sample before it, in
        rad.
        """
        low, high = self.angle_rad
        margin = self.following_error_rad
        for joint, at in enumerate(angle):
            if not low - margin <= at <= high + margin:
                return (
                    f"joint {joint + 1} is at {at:.3f} rad, outside its limits (limits.angle_rad)"
                )
            if not abs(current[joint]) <= self.current_a:
                return (
                    f"joint {joint + 1} draws {current[joint]:.2f} A, "
                    f"the limit is {self.current_a:g} A (limits.current_a)"
                )
            if not abs(at - goal[joint]) <= margin:
                return (
                    f"joint {joint + 1} is {at - goal[joint]:.3f} rad away from its goal, "
                    f"the limit is {margin:g} rad (limits.following_error_rad)"
                )
            if not abs(at - angle_before[joint]) <= self.jump_rad:
                return (
                    f"joint {joint + 1} jumped by {at - angle_before[joint]:.3f} rad, "
                    "an encoder fault"
                )
        if not math.isfinite(di):
            return f"the Deformation Index is {di}"
        for k, axis in enumerate("xyz"):
            if not self.tip_min_m[k] <= tip[k] <= self.tip_max_m[k]:
                return (
                    f"the predicted tip has {axis} = {tip[k]:.3f} m, outside its box "
                    "(limits.tip_min_m, limits.tip_max_m)"
                )
        return ""

    def goal_violation(
        self,
        goal: Sequence[float],
        *,
        before: Sequence[float],
        velocity: Sequence[float],
        period_s: float,
    ) -> str:
        """Return the first limit that a goal violates, as a sentence; empty for none.

        `goal`, `before`: goals in question, and those one period before, in rad.
        `velocity`: rate at which the goals before were reached, in rad/s.
        """
        low, high = self.angle_rad
        for joint, value in enumerate(goal):
            who = f"the goal of joint {joint + 1}"
            if not low <= value <= high:
                return (
                    f"{who} is {value:.3f} rad, outside {low:g} to {high:g} rad (limits.angle_rad)"
                )
            rate = (value - before[joint]) / period_s
            if not abs(rate) <= self.rate_rad_s * _ROUNDING:
                return (
                    f"{who} moves at {rate:.2f} rad/s, "
                    f"the limit is {self.rate_rad_s:g} rad/s (limits.rate_rad_s)"
                )
            acceleration = (rate - velocity[joint]) / period_s
            if not abs(acceleration) <= self.acceleration_rad_s2 * _ROUNDING:
                return (
                    f"{who} accelerates at {acceleration:.1f} rad/s2, "
                    f"the limit is {self.acceleration_rad_s2:g} rad/s2 (limits.acceleration_rad_s2)"
                )
        return ""
