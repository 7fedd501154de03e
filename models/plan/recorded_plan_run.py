"""Recorded run of a plan: goals sent, angles and tip measured, row by row of the plan.

A trial (CSV and TOML, of `dropstitch import` or `dropstitch sil`) holds the tip by motion capture,
a log of `dropstitch run` the tip that the robot predicted with its observer. Of several runs in one
recording the last complete one counts, because the robot's estimate of the payload has settled
there.

A trial holds the mass at the tip. The goals sent include the corrections of feedback, which no
recording separates. So the payload between whose plans the robot interpolated can be derived from
the goals only if the plan has no corrections.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.log.logged_run import logged_run
from firmware_py.log.recording import read_recording
from firmware_py.safety.states import SafetyState
from firmware_py.signals import tip_names
from models.trials.trial_files import read_trial

Array = NDArray[np.float64]
ALIKE: Final = 0.15
"""Largest RMS difference of the goals sent from those of the plan, over the RMS of the latter, at
which a recording counts as a run of it [assumed]: goals for payloads 2 kg apart differ by 0.1."""
VALLEY: Final = 0.02
"""Squared difference over the squared goals, above the smallest, that still belongs to a run of the
plan: a shift by some rows causes that much [assumed]."""
MOST: Final = 1e6
"""Largest goal, angle or place, in radians and metres: far beyond any robot [assumed]."""
LEAST_FRESH: Final = 0.9
"""Least fraction of rows with a measurement; between them it is interpolated [assumed]."""


CORRECTED_KG: Final = 0.25
"""Distance from the mass at the tip within which corrections, not another payload, explain the
goals of a trial [assumed]: half the step of the default grid."""


@dataclass(frozen=True)
class RecordedRun:
    """One run of a plan."""

    goals_rad: Array  # (n, dof), goals sent at each row
    angle_rad: Array  # (n, dof), angles measured at each row
    tip_m: Array  # (n, dof)
    # Mass at the tip: the trial's, or the one that the robot was set to or estimated
    payload_kg: float
    goals_payload_kg: float  # Payload, within the grid, that the goals were interpolated at
    source: str  # Source of the tip: "mocap" or "observer"
    sha256: str  # Hash of the file


def read_plan_run(path: Path, plan: TipPlan) -> RecordedRun:
    """Read the last complete run of a plan from a trial (`.csv`) or a log of the robot
    (`.mcap`).
    """
    _check_size(f"plan {plan.path}", plan.goals_rad())
    if path.suffix == ".csv":
        (table, payload_kg, went_by_kg), source = _of_trial(path, plan), "mocap"
    else:
        (table, payload_kg, went_by_kg), source = _of_log(path, plan), "observer"
    goals, angle, tip = (table[:, k * plan.dof : (k + 1) * plan.dof] for k in range(3))
    fitting_kg, difference = fitting_payload(plan, goals)
    scale = float(np.sqrt(np.mean(interpolated(plan, fitting_kg) ** 2)))
    if difference > ALIKE * scale:
        raise InputError(
            path, f"is no run of the plan {plan.path}: its goals differ by {difference:.3f} rad",
            "name a recording of this plan",
        )  # fmt: skip
    goals_payload_kg = _goals_payload_kg(plan, fitting_kg, payload_kg, went_by_kg)
    return RecordedRun(
        goals, angle, tip, goals_payload_kg if payload_kg is None else payload_kg,
        goals_payload_kg, source, hashlib.sha256(path.read_bytes()).hexdigest(),
    )  # fmt: skip


def interpolated(plan: TipPlan, payload_kg: float) -> Array:
    """Goals of a plan for a payload, as the robot interpolates them, shape (n, dof)."""
    return np.asarray(np.einsum("p,pnj->nj", payload_weights(plan, payload_kg), plan.goals_rad()))


def payload_weights(plan: TipPlan, payload_kg: float) -> Array:
    """Weight of the goals for each payload of the grid in the interpolation, shape (p,)."""
    grid = plan.grid_kg
    return np.array([np.interp(payload_kg, grid, row) for row in np.eye(len(grid))])


def fitting_payload(plan: TipPlan, goals_rad: Array) -> tuple[float, float]:
    """Payload whose interpolated goals are nearest to those sent, and their RMS difference.

    Shapes: `goals_rad` (n, dof).
    """
    tables, grid = plan.goals_rad(), plan.grid_kg
    candidates = []
    for k in range(max(1, len(grid) - 1)):
        way = tables[k + 1] - tables[k] if len(grid) > 1 else np.zeros_like(tables[0])
        size = float(np.sum(way**2))
        part = float(np.sum((goals_rad - tables[k]) * way)) / size if size > 0 else 0.0
        part = min(max(part, 0.0), 1.0)
        rms = float(np.sqrt(np.mean((goals_rad - tables[k] - part * way) ** 2)))
        step = grid[k + 1] - grid[k] if len(grid) > 1 else 0.0
        candidates.append((rms, float(grid[k] + part * step)))
    rms, payload_kg = min(candidates)
    return payload_kg, rms


def _goals_payload_kg(
    plan: TipPlan, fitting_kg: float, payload_kg: float | None, went_by_kg: float | None
) -> float:
    """Payload that the goals were interpolated at, without corrections."""
    if plan.feedback is None or plan.feedback.size_rad == 0.0:
        return fitting_kg
    low, high = plan.grid_kg[0], plan.grid_kg[-1]
    if went_by_kg is not None:
        return float(np.clip(went_by_kg, low, high))
    if payload_kg is None:
        return fitting_kg
    # The robot of a trial may have estimated the mass at the tip, with a large error.
    told_kg = float(np.clip(payload_kg, low, high))
    return told_kg if abs(fitting_kg - told_kg) <= CORRECTED_KG else fitting_kg


def _of_log(path: Path, plan: TipPlan) -> tuple[Array, float | None, float | None]:
    """Table of the last complete run, the mass at the tip, and the payload that the robot used."""
    log = read_recording(path)
    _check_dof(path, log.dof, plan)
    columns = log.columns
    tick = columns["tick"].astype(np.int64)
    fresh = (columns["stale_ticks"] == 0) & (columns["state"] < SafetyState.STOPPING)
    if not fresh.any():
        raise InputError(path, "holds no fresh measurement", "record the run again")
    runs = int(tick[fresh].max() + 1) // plan.rows
    start = (runs - 1) * plan.rows
    if runs < 1:
        raise InputError(path, f"ends before the {plan.rows} rows of the plan", "run it once whole")
    inside = fresh & (tick >= start) & (tick < start + plan.rows)
    if np.count_nonzero(inside) < LEAST_FRESH * plan.rows:
        raise InputError(
            path, f"misses {plan.rows - np.count_nonzero(inside)} of {plan.rows} measurements",
            "record the run again",
        )  # fmt: skip
    names = _joint_names(plan.dof) + [f"predicted_{n}" for n in tip_names()[: plan.dof]]
    grid = np.arange(start, start + plan.rows)
    table = np.column_stack([np.interp(grid, tick[inside], columns[n][inside]) for n in names])
    _check_size(path, table)
    facts, estimate = logged_run(log), columns["payload_kg"][inside]
    went_by_kg = facts.assumed_payload_kg
    if went_by_kg is None and np.isfinite(estimate).all():
        went_by_kg = float(estimate.mean())
    return table, facts.payload_kg, went_by_kg


def _of_trial(path: Path, plan: TipPlan) -> tuple[Array, float | None, float | None]:
    """Table and mass as in `_of_log`; a trial does not record the payload that the robot used."""
    trial = read_trial(path)
    _check_dof(path, trial.meta.dof, plan)
    table = trial.stack(*_joint_names(plan.dof), *tip_names()[: plan.dof])
    if not np.isfinite(table).all():
        table = _filled(table, path)
    _check_size(path, table)
    grid = np.arange(0.0, trial.time_s[-1] - trial.time_s[0] + 1e-9, plan.period_s)
    since = trial.time_s - trial.time_s[0]
    table = np.column_stack([np.interp(grid, since, column) for column in table.T])
    if len(table) < plan.rows:
        raise InputError(path, f"is shorter than the {plan.rows} rows of the plan", "run it whole")
    start = _start_row(table[:, : plan.dof], plan)
    return table[start : start + plan.rows], trial.meta.payload_kg, None


def _check_size(path: Path | str, table: Array) -> None:
    """Refuse values whose squares would overflow."""
    if not np.all(np.abs(table) < MOST):
        raise InputError(
            path,
            f"has goals, angles or places that are not finite or beyond {MOST:g}",
            "record it again",
        )


def _filled(table: Array, path: Path) -> Array:
    rows = np.arange(len(table))
    for column in table.T:
        fresh = np.isfinite(column)
        if np.count_nonzero(fresh) < LEAST_FRESH * len(column):
            raise InputError(path, "has too many empty cells", "record the run again")
        column[~fresh] = np.interp(rows[~fresh], rows[fresh], column[fresh])
    return table


def _start_row(goals: Array, plan: TipPlan) -> int:
    """Row of a recording at which its last complete run begins, by matching the plan's goals."""
    wanted = np.mean(plan.goals_rad(), axis=0)
    starts = len(goals) - plan.rows + 1
    size, total = 1 << (len(goals) + plan.rows).bit_length(), np.zeros(starts)
    for own, sent in zip(wanted.T, goals.T, strict=True):
        both = np.fft.rfft(sent, size) * np.conj(np.fft.rfft(own, size))
        power = np.concatenate([[0.0], np.cumsum(sent**2)])
        total += power[plan.rows :] - power[:starts] + np.sum(own**2)
        total -= 2.0 * np.fft.irfft(both, size)[:starts]
    near = total <= total.min() + VALLEY * float(np.sum(wanted**2))
    last = int(np.flatnonzero(near)[-1])  # inside the last valley, whose minimum is the start
    low = max(0, last - plan.rows // 2)
    return low + int(np.argmin(total[low : last + 1]))


def _joint_names(dof: int) -> list[str]:
    joints = range(1, dof + 1)
    return [f"goal_{j}_rad" for j in joints] + [f"angle_{j}_rad" for j in joints]


def _check_dof(path: Path, dof: int, plan: TipPlan) -> None:
    if dof != plan.dof:
        raise InputError(
            path, f"is of {dof} joints, the plan of {plan.dof}", "name a recording of this plan"
        )
