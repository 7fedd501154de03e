"""Limits of goals and measurements, the checks against them, and the limits that a link sets.

A limit is the last permitted value. `firmware_py.safety.supervisor` decides how to react to a
violation.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.bus.servo_models import MODELS
from firmware_py.core.errors import InputError
from firmware_py.link.link_description import LinkDescription, read_link

_ROUNDING: Final = 1.0 + 1e-9
"""Rounding tolerance of a rate or acceleration of goals at the limit, by finite differences."""


class Limits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits of the robot (table `[limits]` of robot.toml), the same for every joint."""

    # Range of the goals; measured angles may exceed it by `following_error_rad`
    angle_rad: tuple[float, float] = (-0.6, 0.6)
    rate_rad_s: float = 2.0  # Largest rate of the goals
    # Largest acceleration of the goals. The study's motion starts at full speed: 0.76 rad/s within
    # one period.
    acceleration_rad_s2: float = 60.0
    current_a: float = 8.0  # Largest magnitude of the motor current
    # Largest difference between a measured angle and the goal sent before it
    following_error_rad: float = 0.2
    # Largest change of a measured angle between two samples; more is an encoder fault
    jump_rad: float = 0.1
    # Lower corner, in the world frame, of the box that must contain the predicted tip
    tip_min_m: tuple[float, float, float] = (-1.2, -1.2, 0.0)
    tip_max_m: tuple[float, float, float] = (1.2, 1.2, 1.3)  # Upper corner of that box
    persistence_ticks: int = 3  # Consecutive samples beyond a limit that stop the robot
    # Consecutive samples that repeat angle and current of a joint, although its goal moves, that
    # stop the robot (`firmware_py.safety.limits`)
    frozen_ticks: int = 10
    # Consecutive ticks without fresh data, or consecutive missed slots, that stop the robot
    stale_ticks: int = 3
    # Largest count of missed slots, reduced by one with each punctual tick. A larger count means
    # that the loop is too slow for its period, and stops the robot.
    missed_slots: int = 12
    blend_s: float = 1.0  # Shortest duration of a blend into the motion
    stop_deceleration_rad_s2: float = 6.0  # Deceleration of the goals in a controlled stop
    hold_s: float = 0.5  # Hold of the last goal before torque off

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

        `goal`: goals sent before the sample, in rad. `angle_before`: angles of the previous sample.
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

        `goal`, `before`: new goals and those of the previous period, in rad.
        `velocity`: rate of the goals in the previous period, in rad/s.
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


LEAST_MOTION_RAD: Final = 8 * max(model.rad_per_pulse for model in MODELS.values())
"""Range of a goal that a servo must show: eight pulses of the coarsest encoder, 0.012 rad
[assumed]. The static friction of a gear holds an angle over some pulses, but not the current."""


class FrozenFeedback:
    """Detector of servos that repeat their measurement although their goal moves.

    A sensor, a servo or an adapter may keep answering, well-formed and in time, with an old value.
    The following error shows it only in large motions. But a driven joint whose goal has moved by
    more than its encoder resolves changes its angle, or else its current, because the position loop
    pushes. So a joint counts as frozen if angle and current are both identical for `ticks` fresh
    samples after its goal has moved that far. A joint at rest, or in a motion too slow to show,
    never does.
    """

    def __init__(self, dof: int, ticks: int) -> None:
        self._dof, self._ticks = dof, ticks
        self.reset()

    def reset(self) -> None:
        self._sample = [(float("nan"), float("nan"))] * self._dof
        self._low, self._high = [0.0] * self._dof, [0.0] * self._dof
        self._repeats = [0] * self._dof

    def joint(
        self, angle_rad: Sequence[float], current_a: Sequence[float], goal_rad: Sequence[float]
    ) -> int | None:
        """Note a fresh sample; return the first frozen joint, from 0, or None.

        `goal_rad`: goals sent before the sample.
        """
        frozen = None
        for j, sample in enumerate(zip(angle_rad, current_a, strict=True)):
            goal = goal_rad[j]
            if sample != self._sample[j]:
                self._sample[j] = sample
                self._low[j] = self._high[j] = goal
                self._repeats[j] = 0
                continue
            self._low[j], self._high[j] = min(self._low[j], goal), max(self._high[j], goal)
            if self._high[j] - self._low[j] > LEAST_MOTION_RAD:
                self._repeats[j] += 1
                if self._repeats[j] >= self._ticks and frozen is None:
                    frozen = j
        return frozen


BOX_MARGIN: Final = 1.2
"""Ratio of the tip's box to the reach of a straight link [assumed]: room for the bend."""


def limits_with_link(
    where: Path, link_file: str, models: Sequence[str], limits: Limits, stated: Collection[str]
) -> Limits:
    """Return the limits of a configuration that names a link; `stated` has its keys of [limits]."""
    link = read_link(where.parent / link_file)
    refuse_other_servos(link, models, where)
    return limits_of_link(link, limits, stated)


def refuse_other_servos(link: LinkDescription, models: Sequence[str], where: Path | str) -> None:
    """Refuse servos of another model than the link's."""
    if len(models) > link.joints:
        raise InputError(
            where, f"servos has {len(models)} entries, the link {link.joints} joint",
            "correct 'servos', or 'joints' in the link's file",
        )  # fmt: skip
    for model in models:
        if model != link.servo.model:
            raise InputError(
                where, f"servo {model} is not the link's {link.servo.model}",
                "correct 'servos', or [servo] in the link's file",
            )  # fmt: skip


def limits_of_link(link: LinkDescription, limits: Limits, stated: Collection[str]) -> Limits:
    """Return limits in which the link sets the tip's box, current and rate that are not given.

    Current and rate are only lowered, to the limits of the servo.
    """
    reach_m = round(BOX_MARGIN * (link.base_offset_m + link.length_m), 3)
    of_link = {
        "tip_min_m": (-reach_m, -reach_m, -reach_m),
        "tip_max_m": (reach_m, reach_m, reach_m),
        "current_a": min(limits.current_a, link.preset.current_limit_a),
        "rate_rad_s": min(limits.rate_rad_s, link.preset.speed_limit_rad_s),
    }
    return msgspec.structs.replace(
        limits, **{key: value for key, value in of_link.items() if key not in stated}
    )
