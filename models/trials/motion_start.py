"""Row at which the motion of a recording starts, detected from the goals."""

from __future__ import annotations

from typing import Final

import numpy as np

from firmware_py.errors import InputError
from firmware_py.motion import KINDS, Motion
from models.trials.trial import Array, Trial

REST_FRACTION: Final = 1e-3
"""Largest change of a goal at rest, as a fraction of the goal's range [assumed]."""

JUMP_FRACTION: Final = 0.05
"""Least change of a goal from one row to the next that may be a step, as a fraction of its range
[assumed]."""

SMOOTHEST_START_ROWS: Final = 120
"""Rows within which a reference motion has changed by `REST_FRACTION`; a multisine of 20 s needs
34."""

GOAL_TOLERANCE: Final = 0.01
"""Largest root mean square difference between the goals and a motion, as a fraction of the largest
goal: the resolution of a small servo is a seventh of that [assumed]."""


def motion_start(trial: Trial) -> int:
    """Row of time zero of a trial.

    Where the conditions name a reference motion and the goals follow it, in either direction, the
    row is fitted to the goals. Otherwise it is `rest_samples` of the conditions.
    """
    meta, known = trial.meta, trial.meta.rest_samples
    kind = next((k for k in KINDS if k == meta.motion), None)
    if kind is None or "goal_1_rad" not in trial.columns:
        return known
    goals = trial.goal_rad
    try:
        motion = Motion(
            kind, amplitude_rad=meta.amplitude_rad, period_s=meta.period_s, dof=meta.dof,
            phase_2_rad=meta.phase_2_rad,
        )  # fmt: skip
    except InputError:
        return known
    first = rows_at_rest(goals)
    starts = np.arange(max(first - SMOOTHEST_START_ROWS, 0), min(first + 1, len(trial) - 1) + 1)
    wanted = motion.goal_rad(trial.step_s * np.arange(-starts[-1], len(trial) - starts[0]))
    end = min(len(trial), int(starts[0] + motion.duration_s / trial.step_s))
    errors = {}
    for start in starts.tolist():
        own = wanted[starts[-1] - start :][:end]
        squares = [np.mean((goals[:end] - turned) ** 2) for turned in (own, -own)]
        errors[start] = float(np.sqrt(min(squares)))
    best = min(errors, key=errors.__getitem__)
    return best if errors[best] <= GOAL_TOLERANCE * np.abs(goals).max() else known


def rows_at_rest(goals: Array) -> int:
    """Rows before the goals of any motion start; `goals` has shape (n, goals).

    A smooth motion first changes in the row after time zero, a step in the row of time zero.
    """
    scale = np.ptp(goals, axis=0)
    moved = np.flatnonzero(np.any(np.abs(goals - goals[0]) > REST_FRACTION * scale, axis=1))
    if not len(moved):
        return len(goals)
    first = int(moved[0])
    now = np.abs(goals[first] - goals[first - 1])
    later = np.abs(goals[min(first + 1, len(goals) - 1)] - goals[first])
    steps = (now > JUMP_FRACTION * scale) & (now > 2.0 * later)
    return first if steps.any() else first - 1
