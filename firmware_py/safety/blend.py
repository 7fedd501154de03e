"""How goals go from where the arm stands over into the motion, without a jump.

========= ===================================== ===============================================
way       when                                  how
========= ===================================== ===============================================
approach  the run begins                        to where the motion begins, and the motion waits
absorb    slots were missed                     the motion with an offset that fades away, so
                                                that its speed is kept
take up   the motion is in its midst, and the   from rest over into it: a goal lies between the
          arm at rest (after a replug)          two, so where both keep to the angles it does
========= ===================================== ===============================================

Each follows a quintic, which is at rest at both ends, and takes as long as a quarter of the rate
and of the acceleration allowed asks for. An approach alone is within every limit by itself; the
others add to the motion's own speed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from firmware_py.safety.limits import Limits

_SHARE: Final = 0.25
"""Of the limits of rate and acceleration that a blend may use."""
_PEAK_RATE: Final = 1.875
"""Steepest slope of the quintic, at its middle, in mean slopes."""
_PEAK_ACCELERATION: Final = 10.0 / math.sqrt(3.0)
"""Largest second derivative of the quintic over the unit interval."""


class Blend:
    """One way over at a time; see the module's text.

    Parameters
    ----------
    limits : Limits
        What the goals have to keep to.
    dof : int
        Number of joints.
    period_s : float
        Control period.
    """

    def __init__(self, limits: Limits, dof: int, period_s: float) -> None:
        self._limits, self._period_s = limits, period_s
        self._from_rest, self._tick, self._ticks = False, 0, 0
        self._anchor = [0.0] * dof
        self._offset = [0.0] * dof

    def approach(self, goal: Sequence[float], start: Sequence[float]) -> int:
        """Go to a place and rest there; return how many ticks that takes.

        Parameters
        ----------
        goal, start : sequence of float
            Where the goals stand and where the motion begins, in rad.
        """
        self._leave(goal, max(abs(to - at) for to, at in zip(start, goal, strict=True)))
        return self._ticks

    def absorb(self, goal: Sequence[float], wished_before: Sequence[float]) -> None:
        """Let the last goal stand for what the motion wished then; the difference fades away.

        Parameters
        ----------
        goal, wished_before : sequence of float
            The last goal, and the motion one period before the goal to come, in rad.
        """
        if self._from_rest and self._tick < self._ticks:
            self.take_up(goal)
            return
        self._from_rest = False
        self._offset[:] = (at - to for at, to in zip(goal, wished_before, strict=True))
        self._begin(max(map(abs, self._offset)))

    def take_up(self, goal: Sequence[float]) -> None:
        """Go over into the motion, wherever it is within the limits."""
        low, high = self._limits.angle_rad
        self._leave(goal, max(max(high - at, at - low) for at in goal))

    def _leave(self, goal: Sequence[float], distance: float) -> None:
        self._from_rest = True
        self._anchor[:] = goal
        self._begin(distance)

    def _begin(self, distance: float) -> None:
        limits = self._limits
        least_s = max(
            limits.blend_s,
            _PEAK_RATE * distance / (_SHARE * limits.rate_rad_s),
            math.sqrt(_PEAK_ACCELERATION * distance / (_SHARE * limits.acceleration_rad_s2)),
        )
        self._tick, self._ticks = 0, math.ceil(least_s / self._period_s) if distance else 0

    def next(self, wished: list[float]) -> list[float]:
        """Return the goals one tick on, where the motion wishes for others; both in rad."""
        if self._tick == self._ticks:
            return wished
        left = self._left()
        if self._from_rest:
            pairs = zip(wished, self._anchor, strict=True)
            return [to + left * (anchor - to) for to, anchor in pairs]
        return [to + left * offset for to, offset in zip(wished, self._offset, strict=True)]

    def _left(self) -> float:
        """Share of the way that is left: a quintic from 1 to 0, at rest at both ends."""
        self._tick += 1
        x = self._tick / self._ticks
        return 1.0 - x * x * x * (10.0 + x * (6.0 * x - 15.0))
