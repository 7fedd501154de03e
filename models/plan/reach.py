"""Reach of the arm: whether its tip can rest where a path leads, with every payload."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from firmware_py.errors import InputError
from firmware_py.safety.limits import Limits
from models.plan.plan_timeline import Timeline
from models.plan.twin_sensitivity import TipTwin

Array = NDArray[np.float64]
CLOSE_M: Final = 2e-3
"""Distance above which a place counts as out of reach [assumed]."""
STEPS: Final = 6
"""Steps of the search: the tip is nearly linear in the goals."""
PROBE_RAD: Final = 1e-3
TINY: Final = 1e-9
"""Least distance between the bounds of the search, rad."""


def check_reach(
    twin: TipTwin, line: Timeline, payloads_kg: Sequence[float], limits: Limits, where: str
) -> None:
    """Refuse a path whose farthest points the resting tip cannot reach within the angle limits.

    The path is checked first, then the ways there and back, which swing out if the path is fast at
    its ends.
    """
    path = slice(line.start_row, line.end_row)
    for part, what, remedy in (
        (path, "leads", "make the path smaller, or move its centre"),
        (slice(0, None), "of the way there or back leads", "let the path begin and end slower"),
    ):
        desired_m, first = line.desired_m[part], part.start
        for row in _farthest(desired_m):
            for payload_kg in (payloads_kg[0], payloads_kg[-1]):
                nearest = nearest_rest_m(twin, desired_m[row], payload_kg, limits)
                if np.linalg.norm(nearest - desired_m[row]) > CLOSE_M:
                    raise InputError(
                        where, f"row {first + row} ({(first + row) * twin.period_s:.2f} s) {what} "
                        f"to {_place(desired_m[row])}, which the tip cannot reach with "
                        f"{payload_kg:g} kg and goals within limits.angle_rad; the nearest place "
                        f"is {_place(nearest)}", remedy,
                    )  # fmt: skip


def nearest_rest_m(twin: TipTwin, wanted_m: Array, payload_kg: float, limits: Limits) -> Array:
    """Place nearest to a wanted one at which the tip can rest, shape (dof,).

    Shapes: `wanted_m` (dof,).
    """
    low, high = limits.angle_rad
    goal = np.zeros(twin.dof)
    tip = twin.resting_tip_m(goal, payload_kg)
    for _ in range(STEPS):
        slope = np.column_stack(
            [
                (twin.resting_tip_m(goal + PROBE_RAD * unit, payload_kg) - tip) / PROBE_RAD
                for unit in np.eye(twin.dof)
            ]
        )
        # Bounded by the limits: if one joint is at its limit, the other comes as near as it can.
        step = lsq_linear(slope, wanted_m - tip, (low - goal - TINY, high - goal + TINY)).x
        goal = np.clip(goal + step, low, high)
        tip = twin.resting_tip_m(goal, payload_kg)
    return tip


def _farthest(desired_m: Array) -> list[int]:
    """First rows of the largest distance, and of the largest and smallest coordinates."""
    extreme = [int(np.argmax(np.sum(desired_m**2, axis=1)))]
    for column in desired_m.T:
        extreme += [int(np.argmax(column)), int(np.argmin(column))]
    return sorted(set(extreme))


def _place(tip_m: Array) -> str:
    text = ", ".join(f"{value + 0.0:.3f}" for value in np.round(tip_m, 3))
    return f"({text}) m" if len(tip_m) > 1 else f"x = {text} m"
