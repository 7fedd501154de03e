"""Trapezoidal profile of a goal: one step of the set-point, limited in speed and acceleration.

A profiling servo accelerates its set-point to the speed limit, holds that speed, and decelerates so
that it comes to rest at the goal (docs/sources.md, "Control tables"). It plans again when the next
goal arrives. With the remaining distance e, the speed v towards the goal and the acceleration a,
the set-point accelerates until v² = 2 a (remaining distance): up to the speed √(v²/2 + a e), or to
the limit. A goal that moves at the speed v is followed v / 2a late.
"""

from __future__ import annotations

from typing import Final

import casadi as ca

from models.plant.scope import Expr

NO_ACCELERATION_LIMIT: Final = 1e6
"""Acceleration in rad/s² that counts as no limit: a change of 10 rad takes 6 ms."""

LEAST_SQUARED_SPEED: Final = 1e-12
"""Added below the root, in (rad/s)²: keeps its derivative finite at rest."""


def profiled_change(
    left: Expr, rate: Expr, speed: Expr, acceleration: Expr, step_s: Expr
) -> tuple[Expr, Expr]:
    """Change of the set-point in one step, and its final rate; `left` is the distance to go."""
    towards = ca.if_else(left >= rate * ca.fabs(rate) / (2 * acceleration), 1, -1)
    way, begun = towards * left, towards * rate
    squared = ca.fmax(begun**2 / 2 + acceleration * way, 0) + LEAST_SQUARED_SPEED
    top = ca.fmin(ca.sqrt(squared), speed)
    rise_s, fall_s = (top - begun) / acceleration, top / acceleration
    level = way - (top + begun) / 2 * rise_s - top / 2 * fall_s
    level_s = ca.fmax(level, 0) / top
    rising_s = ca.fmin(rise_s, step_s)
    levelling_s = ca.fmin(ca.fmax(step_s - rise_s, 0), level_s)
    falling_s = ca.fmin(ca.fmax(step_s - rise_s - level_s, 0), fall_s)
    change = (
        (begun + acceleration / 2 * rising_s) * rising_s
        + top * levelling_s
        + (top - acceleration / 2 * falling_s) * falling_s
    )
    arrived = step_s >= rise_s + level_s + fall_s
    ended = begun + acceleration * (rising_s - falling_s)
    return towards * ca.if_else(arrived, way, change), towards * ca.if_else(arrived, 0, ended)
