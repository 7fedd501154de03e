"""Errors of the tip in a run: prediction error, distance from a planned path, figures of moves.

The true tip is that of the simulated plant at the sampling time of each tick's measurement.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import tip_names
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.safety.states import SafetyState
from hil.emulator.emulator import Truth
from hil.sil.timing_document import MoveFigures, PathError, PredictionError, TipErrors
from models.predictor.validation import axis_coverage

Array = NDArray[np.float64]

CLOSE_M: Final = 0.010
"""Settling band around the rest position (the task's ±10 mm)."""
REST_FRACTION: Final = 0.2
"""Final fraction of a move's rows whose mean is the rest position [assumed]."""
APPROACH: Final = "approach"
"""Part of a run before its motion: the way to the first goal, and the probing motion of a plan."""
NO_ERRORS: Final = TipErrors(
    n=0, mean_euclidean_distance_m=None, rms_m=None, p95_m=None, max_m=None,
    interval_coverage=None, interval_coverage_least=None, in_range_fraction=None,
)  # fmt: skip


def true_tip_m(records: NDArray[np.void], truth: Truth) -> Array:
    """True tip at the sampling time of each tick's measurement, shape (n, 3).

    After a retry the second reading counts. Rows without a fresh measurement are NaN: no servo was
    read in the tick, or its reply is stale.
    """
    tip = np.full((len(records), 3), np.nan)
    if len(truth.time_ns) == 0:
        return tip
    wake_ns = records["deadline_ns"] + records["lateness_ns"]
    sample = np.searchsorted(truth.time_ns, wake_ns + records["busy_ns"], side="right") - 1
    inside = (sample >= 0) & (truth.time_ns[sample] >= wake_ns) & (records["stale_ticks"] == 0)
    tip[inside] = truth.tip_m[sample[inside]]
    return tip


def predicted_tip_m(records: NDArray[np.void]) -> Array:
    """Tip that the robot predicted, shape (n, 3)."""
    return np.column_stack([records[name] for name in tip_names("predicted_")])


def programme_part(time_s: Array, programme: Mapping[str, float]) -> NDArray[np.str_]:
    """Name of the programme's part at each time, shape (n,); "approach" before its beginning."""
    ends_s = np.cumsum(list(programme.values()))
    # Half a microsecond covers the rounding of a slot's time, its number times the period.
    since_s = time_s + 5e-7
    part = np.searchsorted(ends_s, np.mod(since_s, ends_s[-1]), side="right")
    return np.where(since_s < 0, APPROACH, np.array(list(programme))[part])


def prediction_error(
    records: NDArray[np.void], truth: Truth, programme: Mapping[str, float] | None = None
) -> PredictionError:
    """Distance between predicted and true tip over all ticks with a fresh measurement.

    With `programme`, the durations of the parts that the run repeats, it also returns the error of
    each part and of the controlled stop.
    """
    error_m = predicted_tip_m(records) - true_tip_m(records, truth)
    fresh = np.asarray(np.isfinite(error_m).all(axis=1))
    in_range = records["in_range"].astype(bool)
    parts: dict[str, NDArray[np.bool_]] = {"in_range": in_range, "out_of_range": ~in_range}
    if programme:
        stopping = records["state"] >= SafetyState.STOPPING
        part = programme_part(records["time_s"], programme)
        names = (APPROACH, *programme)
        parts |= {n: np.asarray(part == n) & ~stopping for n in names} | {"stop": stopping}
    by_part = {name: _errors(records, error_m, fresh & rows) for name, rows in parts.items()}
    return PredictionError(
        **msgspec.structs.asdict(_errors(records, error_m, fresh)),
        parts={name: errors for name, errors in by_part.items() if errors.n},
    )


def _errors(records: NDArray[np.void], error_m: Array, rows: NDArray[np.bool_]) -> TipErrors:
    if not rows.any():
        return NO_ERRORS
    distance_m = np.linalg.norm(error_m[rows], axis=1)
    half_width_m = np.column_stack([records[f"half_width_{axis}_m"] for axis in "xyz"])
    dof = 2 if "angle_2_rad" in (records.dtype.names or ()) else 1
    coverage = axis_coverage((np.abs(error_m) <= half_width_m)[rows], dof)
    return TipErrors(
        n=int(rows.sum()),
        mean_euclidean_distance_m=float(distance_m.mean()),
        rms_m=float(np.sqrt(np.mean(distance_m**2))),
        p95_m=float(np.quantile(distance_m, 0.95)),
        max_m=float(distance_m.max()),
        interval_coverage=coverage.mean,
        interval_coverage_least=coverage.least,
        in_range_fraction=float(records["in_range"].astype(bool)[rows].mean()),
    )


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


def path_errors(runs_m: Array, plan: TipPlan) -> tuple[PathError, ...]:
    """Distance of the tip from the path for each run of a plan, by `tip_of_runs_m`."""
    desired, errors = plan.desired_tip_m(), []
    for tip in runs_m:
        away = np.linalg.norm(tip - desired, axis=1)
        fresh = np.isfinite(away)
        on_path = fresh & (np.arange(plan.rows) >= plan.start_row)
        on_path &= np.arange(plan.rows) < plan.end_row
        if on_path.any():
            errors.append(
                PathError(
                    rms_m=_rms(away[fresh]),
                    max_m=float(away[fresh].max()),
                    path_rms_m=_rms(away[on_path]),
                    rows=int(fresh.sum()),
                )
            )
    return tuple(errors)


def move_figures(tip_m: Array, plan: TipPlan) -> tuple[MoveFigures, ...]:
    """Settling time and residual vibration of the tip after each move in one run of a plan.

    `tip_m` is the true tip at each row, shape (n, dof), NaN where it was not measured.
    """
    figures = []
    for first, over, after in plan.moves:
        tip = tip_m[first:after]
        rest = np.nanmean(tip[-max(1, round(REST_FRACTION * len(tip))) :], axis=0)
        away = np.linalg.norm(tip - rest, axis=1)
        outside = np.flatnonzero(np.nan_to_num(away) > CLOSE_M)
        swing = tip[over - first :]
        figures.append(
            MoveFigures(
                settling_s=plan.period_s * (int(outside.max()) + 1 if len(outside) else 0),
                swing_m=0.5 * float(np.max(np.nanmax(swing, axis=0) - np.nanmin(swing, axis=0))),
                offset_m=float(np.linalg.norm(rest - plan.desired_tip_m()[after - 1])),
                command_s=plan.period_s * (over - first),
            )
        )
    return tuple(figures)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
