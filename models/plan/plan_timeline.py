"""Timeline of a plan: rest, way to the path, path, way back, rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.plan.path_shapes import DesiredPath

Array = NDArray[np.float64]
REST_S: Final = 1.0
"""Rest before the motion: that of `[motion]`, the reference of the Deformation Index."""
LEAD_S: Final = 0.4
"""Time before the way in which the goals may already move, because the arm follows them late.
Measured on the twin of the demo, circle of 0.4 m in 8 s: without it 6.6 mm at the start."""
SETTLE_S: Final = 1.0
"""Rest after the way back, in which the goals return to zero [assumed]."""
LEAST_WAY_S: Final = 1.5
"""Shortest time of the way to the path and back [assumed]."""
WAY_SPEED_M_S: Final = 0.3
"""Mean speed of a longer way [assumed]."""


@dataclass(frozen=True)
class Timeline:
    """Desired tip over a whole plan."""

    desired_m: Array  # (n, dof), one row per control period
    rest_rows: int
    start_row: int  # First row of the path
    end_row: int  # First row after the path
    drawn: tuple[tuple[int, int], ...]  # Rows that are drawn: first row, and first row after
    moves: tuple[tuple[int, int], ...] = ()  # Moves from rest to rest, the rest after them included


def timeline(path: DesiredPath, rest_tip_m: Array, period_s: float) -> Timeline:
    """Add rest and ways around a path.

    `rest_tip_m`, shape (dof,): tip at rest with all goals zero, since a link is not quite straight.
    """
    rest, lead, settle = (round(s / period_s) for s in (REST_S, LEAD_S, SETTLE_S))
    there = _way(rest_tip_m, path.tip_m[0], _speed(path.tip_m[:2], period_s), period_s)
    back = _way(rest_tip_m, path.tip_m[-1], -_speed(path.tip_m[-2:], period_s), period_s)[::-1]
    still = np.tile(rest_tip_m, (rest + lead + settle, 1))
    start = rest + lead + len(there)
    end = start + len(path.tip_m)
    before, after = still[: rest + lead], still[:settle]
    desired = np.concatenate([before, there, path.tip_m, back, after])
    drawn, moves = (tuple((start + a, start + b) for a, b in p) for p in (path.drawn, path.moves))
    return Timeline(desired, rest, start, end, drawn, moves)


def _speed(pair: Array, period_s: float) -> Array:
    return np.asarray((pair[1] - pair[0]) / period_s)


def _way(start: Array, end: Array, speed: Array, period_s: float) -> Array:
    """Quintic from rest at a place to a speed at another, without acceleration; the end is left
    out.

    Coefficients from the conditions at both ends, e.g. Spong, Hutchinson and Vidyasagar, *Robot
    Modeling and Control* (2006), section 5.5.2.
    """
    seconds = max(LEAST_WAY_S, float(np.linalg.norm(end - start)) / WAY_SPEED_M_S)
    rows = round(seconds / period_s)
    x = (np.arange(rows) / rows)[:, None]
    distance, slope = end - start, speed * rows * period_s
    return np.asarray(
        start + distance * x**3 * (10 - 15 * x + 6 * x**2) - slope * x**3 * (4 - 7 * x + 3 * x**2)
    )
