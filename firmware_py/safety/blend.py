"""Blending of goals into the motion without a jump.

========= ====================================== ==============================================
blend     when                                   how
========= ====================================== ==============================================
approach  at the start of the run                to the first goal of the motion, which waits
absorb    after missed slots                     the motion plus an offset that decays to zero,
                                                 which keeps the speed of the motion
join      the motion runs and the arm is at rest from rest into the motion: every goal lies
          (after a replug)                       between the two, hence within the angle limits
========= ====================================== ==============================================

Each follows a quintic, which is at rest at both ends (minimum-jerk polynomial; Flash and Hogan,
*J. Neuroscience* 5, 1985). Its duration follows from a quarter of the permitted rate and
acceleration. An approach keeps every limit; the other two add to the motion's own speed.

The distance that a join has to bridge changes while it runs. If the motion is known ahead, the
duration follows from the largest distance during the join, and is extended until blend and motion
together stay within `_ROOM` of the limits. Otherwise, and at most, it follows from the distance to
the angle limits.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Final

import msgspec

from firmware_py.safety.limits import Limits

_FRACTION: Final = 0.25
"""Fraction of the limits of rate and acceleration that a blend may use."""
_ROOM: Final = 0.9
"""Fraction of the limits that blend and known motion may use together. The rest is reserved for
corrections of the goals and for a change of the estimated payload [assumed]."""
_PEAK_RATE: Final = 1.875
"""Largest slope of the quintic, in its middle, relative to its mean slope."""
_PEAK_ACCELERATION: Final = 10.0 / math.sqrt(3.0)
"""Largest second derivative of the quintic on the interval from 0 to 1."""


class Blend:
    """Blend of one of the kinds in the module's table."""

    def __init__(self, limits: Limits, dof: int, period_s: float) -> None:
        self._limits, self._period_s = limits, period_s
        self._room = msgspec.structs.replace(
            limits, rate_rad_s=_ROOM * limits.rate_rad_s,
            acceleration_rad_s2=_ROOM * limits.acceleration_rad_s2,
        )  # fmt: skip
        self._from_rest, self._tick, self._ticks = False, 0, 0
        self._anchor = [0.0] * dof
        self._offset = [0.0] * dof

    def approach(self, goal: Sequence[float], start: Sequence[float]) -> int:
        """Start an approach from the latest goals to the first of the motion; return its ticks."""
        self._leave(goal, max(abs(to - at) for to, at in zip(start, goal, strict=True)))
        return self._ticks

    def absorb(self, goal: Sequence[float], desired_before: Sequence[float]) -> None:
        """Start an offset that keeps the latest goals and then decays to zero.

        `goal`: latest goals in rad. `desired_before`: the motion one period before the next goals.
        """
        if self._from_rest and self.active:
            self.join(goal)
            return
        self._from_rest = False
        self._offset[:] = (at - to for at, to in zip(goal, desired_before, strict=True))
        self._begin(max(map(abs, self._offset)))

    @property
    def active(self) -> bool:
        return self._tick < self._ticks

    def join(self, goal: Sequence[float], ahead: Iterable[Sequence[float]] = ()) -> None:
        """Start a blend from rest into the motion, wherever it is within the limits.

        `ahead`: goals of the motion in the next ticks, in rad; empty if they are not known.
        """
        low, high = self._limits.angle_rad
        self._leave(goal, max(max(high - at, at - low) for at in goal))
        rows = list(itertools.islice(ahead, self._ticks))
        ticks = self._known_ticks(rows)
        while ticks < len(rows) and not self._keeps_limits(rows[:ticks], ticks):
            ticks += max(ticks // 4, 1)
        self._ticks = min(ticks, self._ticks)

    def _known_ticks(self, rows: Sequence[Sequence[float]]) -> int:
        """Return the shortest duration that bridges the largest distance of a known motion."""
        distance = 0.0
        for ticks, row in enumerate(rows, 1):
            pairs = zip(row, self._anchor, strict=True)
            distance = max(distance, *(abs(to - at) for to, at in pairs))
            if ticks >= self._least_ticks(distance):
                return ticks
        return self._ticks

    def _keeps_limits(self, rows: Sequence[Sequence[float]], ticks: int) -> bool:
        """Whether a join along a known motion stays within `_ROOM` of the limits."""
        before, velocity = list(self._anchor), [0.0] * len(self._anchor)
        for tick, row in enumerate(rows, 1):
            goal = self._between(row, _left(tick / ticks))
            if self._room.goal_violation(
                goal, before=before, velocity=velocity, period_s=self._period_s
            ):
                return False
            velocity = [(to - at) / self._period_s for to, at in zip(goal, before, strict=True)]
            before = goal
        return True

    def _leave(self, goal: Sequence[float], distance: float) -> None:
        self._from_rest = True
        self._anchor[:] = goal
        self._begin(distance)

    def _begin(self, distance: float) -> None:
        self._tick, self._ticks = 0, self._least_ticks(distance) if distance else 0

    def _least_ticks(self, distance: float) -> int:
        limits = self._limits
        least_s = max(
            limits.blend_s,
            _PEAK_RATE * distance / (_FRACTION * limits.rate_rad_s),
            math.sqrt(_PEAK_ACCELERATION * distance / (_FRACTION * limits.acceleration_rad_s2)),
        )
        return math.ceil(least_s / self._period_s)

    def next(self, desired: list[float]) -> list[float]:
        if not self.active:
            return desired
        self._tick += 1
        left = _left(self._tick / self._ticks)
        if self._from_rest:
            return self._between(desired, left)
        return [to + left * offset for to, offset in zip(desired, self._offset, strict=True)]

    def _between(self, desired: Sequence[float], left: float) -> list[float]:
        """Interpolate between the motion and the anchor at which the blend began."""
        pairs = zip(desired, self._anchor, strict=True)
        return [to + left * (anchor - to) for to, anchor in pairs]


def _left(x: float) -> float:
    """Return the remaining fraction of the distance: a quintic from 1 to 0."""
    return 1.0 - x * x * x * (10.0 + x * (6.0 * x - 15.0))
