"""Goals against their angles and conditions: not moving, cut, of another period or phase."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from firmware_py.motion import KINDS
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import LARGEST_RAD, LEAST_MOTION_RAD
from models.trials.trial import Array, Trial

LONGEST_STEP_S: Final = 0.05
"""Longest step at which an angle cannot follow a step of its goal within one row."""


def judge_goals(trial: Trial) -> list[ImportFinding]:
    """Findings on the goals of a whole trial."""
    if np.nanmax(np.abs(trial.goal_rad)) > LARGEST_RAD:
        return []  # in another unit
    found = [*judge_standing_goals(trial), *_missing_rows(trial)]
    return [*(found or _sinusoid(trial)), *_phase(trial)]


def judge_standing_goals(trial: Trial) -> list[ImportFinding]:
    """Findings on goals that do not move although the conditions state an amplitude.

    Goals do not move if a joint was moved by hand; such a trial has `amplitude_rad = 0`. There are
    no findings on a trial of a plant that is not the link.
    """
    stated_rad = trial.meta.amplitude_rad
    if not trial.meta.link_length_m > 0 or not stated_rad > LEAST_MOTION_RAD:
        return []
    moved_rad = np.ptp(trial.goal_rad, axis=0)
    for j, (goal, angle) in enumerate(zip(trial.goal_rad.T, trial.angle_rad.T, strict=True)):
        # No servo that holds its goal lets the joint move by 11 degrees.
        beyond_rad = np.ptp(angle) - moved_rad[j]
        if np.std(goal) < LEAST_MOTION_RAD and np.isfinite(angle).all() and beyond_rad > 0.2:
            return causes.STILL_GOAL.raised(
                joint=j + 1, moved_rad=np.ptp(angle), goal_rad=moved_rad[j]
            )
    if not moved_rad.any():
        return causes.STILL_GOALS.raised(stated_rad=stated_rad)
    return [] if moved_rad.all() else causes.IDLE_JOINT.raised(joint=int(np.argmin(moved_rad)) + 1)


def _missing_rows(trial: Trial) -> list[ImportFinding]:
    """Finding on a row in which goal and angle jump together, as an angle lags its goal."""
    if trial.step_s > LONGEST_STEP_S or len(trial) < 8:
        return []
    for j in range(trial.meta.dof):
        goal, angle = (_jumps(values[:, j]) for values in (trial.goal_rad, trial.angle_rad))
        row = int(np.argmax(np.where(goal * angle > 0, np.abs(angle), 0.0)))
        if goal[row] * angle[row] > 0:
            return causes.MISSING_ROWS.raised(
                joint=j + 1, jump=angle[row], row=row + 3, at_s=trial.time_s[row + 1]
            )
    return []


def _jumps(values: Array) -> Array:
    """Changes from row to row, (n - 1,), that differ much from adjacent ones; else zero.

    A jump is 0.02 rad, thirteen steps of a coarse encoder, and twenty times the median change of
    the rate.
    """
    change = np.diff(values)
    limit = max(0.02, 20 * float(np.median(np.abs(np.diff(change)))))
    padded = np.pad(np.abs(change), 2, mode="edge")
    beside = np.max([padded[k : k + len(change)] for k in (0, 1, 3, 4)], axis=0)
    wrapped = np.abs(np.abs(change) - 2 * np.pi) < 0.5
    jumps = (np.abs(change) - 1.5 * beside > limit) & ~wrapped
    return np.asarray(np.where(jumps, change, 0.0))


# --- sinusoids -----------------------------------------------------------------------------------

CLEAN: Final = 0.01
"""Largest root mean square residual of a sinusoid, relative to its amplitude; the steps of a small
servo give 0.001 at 30°."""
CLEAN_RAD: Final = 1e-3
"""The same for a small amplitude: two thirds of a servo's step."""
PERIOD_FRACTION: Final = 0.3
"""Largest relative difference of the fitted period from the declared one."""
LEAST_STEPS: Final = 4
"""Fewest steps per period that samples resolve."""
GLIDE_S: Final = 1.2
"""Time at the end during which a motion may return to zero."""
CYCLES: Final = 1.9
"""Most periods in a fit: less than a motion has, because it may rest after them."""


class SineFit(NamedTuple):
    """Sinusoid fitted to samples."""

    period_s: float
    amplitude: complex  # With the phase at the first sample, as Re(−i a exp(iωt))
    residual: float  # Root mean square


def fit_sine(time_s: Array, goal_rad: Array, period_s: float) -> SineFit:
    """Fit a sinusoid with a known period to goals (n,)."""
    phase = 2 * np.pi * (time_s - time_s[0]) / period_s
    design = np.column_stack([np.ones_like(phase), np.sin(phase), np.cos(phase)])
    terms, *_ = np.linalg.lstsq(design, goal_rad, rcond=None)
    residual = float(np.sqrt(np.mean((goal_rad - design @ terms) ** 2)))
    return SineFit(period_s, complex(terms[1], terms[2]), residual)


def _sinusoid(trial: Trial) -> list[ImportFinding]:
    """Findings on the period of a sinusoid, and on a sinusoid under another name."""
    meta, rest, period_s = trial.meta, trial.meta.rest_samples, trial.meta.period_s
    goal, time_s = trial.goal_rad[rest:, 0], trial.time_s[rest:]
    if meta.motion not in KINDS or len(goal) < 8 or goal.std() < LEAST_MOTION_RAD:
        return []
    # A motion may end with a return to zero, or continue at rest.
    length_s = min(time_s[-1] - time_s[0] - GLIDE_S, CYCLES * period_s)
    window = time_s <= time_s[0] + length_s
    if length_s < 0.95 * period_s or not goal[window].std() > 0:
        return []
    time_s, goal = time_s[window], goal[window]
    is_sinusoid = meta.motion == "sinusoid"
    is_sampled = period_s > LEAST_STEPS * trial.step_s
    stated = fit_sine(time_s, goal, period_s)
    if is_sinusoid and not (is_sampled and stated.residual**2 < 0.5 * goal.var()):
        return causes.NO_SINUSOID.raised(period_s=period_s)
    if not is_sampled:
        return []
    best = minimize_scalar(
        lambda other_s: fit_sine(time_s, goal, other_s).residual, method="bounded",
        bounds=(period_s * (1 - PERIOD_FRACTION), period_s * (1 + PERIOD_FRACTION)),
        options={"xatol": 1e-6 * period_s},
    )  # fmt: skip
    fit = fit_sine(time_s, goal, float(best.x))
    if fit.residual > max(CLEAN * abs(fit.amplitude), CLEAN_RAD):
        return []
    if not is_sinusoid:  # below one and a half periods it may be another motion
        is_long = length_s >= 1.5 * fit.period_s
        return causes.MOTION.raised(period_s=fit.period_s, motion=meta.motion) if is_long else []
    if stated.residual < 3 * fit.residual:
        return []
    off = abs(fit.period_s / period_s - 1)
    return causes.PERIOD.beyond(off, period_s=fit.period_s, stated_s=period_s)


def _phase(trial: Trial) -> list[ImportFinding]:
    """Finding if joint 2 leads joint 1 by another phase than the conditions state."""
    meta = trial.meta
    if meta.dof != 2 or meta.motion != "sinusoid":
        return []
    # The second half of the first cycle and the first half of the second: joint 2 is faded in.
    start_s = trial.time_s[min(meta.rest_samples, len(trial) - 1)] + 0.5 * meta.period_s
    cycle = (trial.time_s >= start_s) & (trial.time_s < start_s + meta.period_s)
    if trial.time_s[-1] < start_s + 0.9 * meta.period_s or cycle.sum() < 8:
        return []
    goals = trial.goal_rad[cycle].T
    one, two = (fit_sine(trial.time_s[cycle], goal, meta.period_s) for goal in goals)
    if any(
        np.std(goal) < LEAST_MOTION_RAD or fit.residual**2 > 0.1 * np.var(goal)
        for goal, fit in zip(goals, (one, two), strict=True)
    ):
        return []  # no phase is defined
    lead = two.amplitude / one.amplitude
    off = float(np.angle(lead * np.exp(-1j * meta.phase_2_rad)))
    shown = float(np.angle(lead * np.exp(1e-9j)))  # half a turn is positive
    return causes.PHASE.beyond(off, lead_rad=shown, stated_rad=meta.phase_2_rad)
