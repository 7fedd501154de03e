"""Settling time and residual vibration of the tip after each move of a plan."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.goals.tip_plan import TipPlan
from hil.sil.timing_document import MoveFigures

Array = NDArray[np.float64]
CLOSE_M: Final = 0.010
"""Settling band around the rest position (the task's ±10 mm)."""
REST_FRACTION: Final = 0.2
"""Final fraction of a move's rows whose mean is the rest position [assumed]."""


def move_figures(tip_m: Array, plan: TipPlan) -> tuple[MoveFigures, ...]:
    """Figures of each move in one run of a plan.

    `tip_m` is the true tip at each row, shape (n, dof), NaN where it was not measured.
    """
    found = []
    for first, over, after in plan.moves:
        tip = tip_m[first:after]
        rest = np.nanmean(tip[-max(1, round(REST_FRACTION * len(tip))) :], axis=0)
        away = np.linalg.norm(tip - rest, axis=1)
        outside = np.flatnonzero(np.nan_to_num(away) > CLOSE_M)
        swing = tip[over - first :]
        found.append(
            MoveFigures(
                settling_s=plan.period_s * (int(outside.max()) + 1 if len(outside) else 0),
                swing_m=0.5 * float(np.max(np.nanmax(swing, axis=0) - np.nanmin(swing, axis=0))),
                offset_m=float(np.linalg.norm(rest - plan.desired_tip_m()[after - 1])),
                command_s=plan.period_s * (over - first),
            )
        )
    return tuple(found)
