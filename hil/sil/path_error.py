"""Path error: distance of the true tip from the path of a plan, for each run of the plan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_py.goals.tip_plan import TipPlan
from firmware_py.safety.states import SafetyState
from hil.emulator.emulator import Truth
from hil.sil.prediction_error import true_tip_m
from hil.sil.timing_document import PathError

Array = NDArray[np.float64]


def tip_of_runs_m(records: NDArray[np.void], truth: Truth, plan: TipPlan) -> Array:
    """True tip at each row of a plan for every complete run, shape (runs, n, dof).

    Rows without a fresh measurement are NaN.
    """
    tip = true_tip_m(records, truth)[:, : plan.dof]
    slot = records["tick"].astype(np.int64)
    counts = (slot >= 0) & (records["state"] < SafetyState.STOPPING)
    runs = int(slot[counts].max() + 1) // plan.rows if counts.any() else 0
    table = np.full((runs * plan.rows, plan.dof), np.nan)
    inside = counts & (slot < len(table))
    table[slot[inside]] = tip[inside]
    return table.reshape(runs, plan.rows, plan.dof)


def path_errors(records: NDArray[np.void], truth: Truth, plan: TipPlan) -> tuple[PathError, ...]:
    """Path error of each complete run of a plan."""
    desired, found = plan.desired_tip_m(), []
    for table in tip_of_runs_m(records, truth, plan):
        away = np.linalg.norm(table - desired, axis=1)
        fresh = np.isfinite(away)
        on_path = fresh & (np.arange(plan.rows) >= plan.start_row)
        on_path &= np.arange(plan.rows) < plan.end_row
        if on_path.any():
            found.append(
                PathError(
                    rms_m=_rms(away[fresh]),
                    max_m=float(away[fresh].max()),
                    path_rms_m=_rms(away[on_path]),
                    rows=int(fresh.sum()),
                )
            )
    return tuple(found)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
