"""Goals against their angles and conditions: not moving, cut, of another period or phase."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from firmware_py.display_units import ANGLE
from firmware_py.motion import KINDS
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import LARGEST_RAD, LEAST_MOTION_RAD
from models.trials.trial import Array, Trial

STILL_RAD: Final = 0.2
"""Motion of an angle, beyond its goal's, that is impossible while a servo holds a goal."""
JUMP_RAD: Final = 0.02
"""Smallest simultaneous jump of goal and angle at a gap: thirteen steps of a coarse encoder."""
JUMP_NOISE: Final = 20.0
"""Smallest jump of a signal, relative to the median change of its rate."""
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
    declared = trial.meta.amplitude_rad
    if not trial.meta.link_length_m > 0 or not declared > LEAST_MOTION_RAD:
        return []
    for j, (goal, angle) in enumerate(zip(trial.goal_rad.T, trial.angle_rad.T, strict=True), 1):
        still = np.std(goal) < LEAST_MOTION_RAD and np.isfinite(angle).all()
        if still and np.ptp(angle) - np.ptp(goal) > STILL_RAD:
            only = f"moves by {ANGLE.text(np.ptp(goal))}" if np.ptp(goal) > 0 else "stands still"
            return causes.STILL_GOAL.raised(joint=j, moved_rad=np.ptp(angle), only=only)
    moved = np.ptp(trial.goal_rad, axis=0)
    if not moved.any():
        return causes.STILL_GOALS.raised(stated=ANGLE.significant(declared))
    still = [j for j, way in enumerate(moved, start=1) if not way]
    return causes.IDLE_JOINT.raised(joint=still[0]) if still else []


def _missing_rows(trial: Trial) -> list[ImportFinding]:
    """Finding on a row in which goal and angle jump together, as an angle lags its goal."""
    if trial.step_s > LONGEST_STEP_S or len(trial) < 8:
        return []
    for j in range(trial.meta.dof):
        goal, angle = (_jumps(values[:, j]) for values in (trial.goal_rad, trial.angle_rad))
        at = np.flatnonzero(goal * angle > 0)
        if len(at):
            row = int(at[np.argmax(np.abs(angle[at]))])
            return causes.MISSING_ROWS.raised(
                joint=j + 1, jump=angle[row], row=row + 3, at_s=trial.time_s[row + 1]
            )
    return []


def _jumps(values: Array) -> Array:
    """Changes from row to row, (n - 1,), that differ much from adjacent ones; else zero."""
    change = np.diff(values)
    apart = np.abs(np.diff(change))
    limit = max(JUMP_RAD, JUMP_NOISE * float(np.median(apart)))
    padded = np.pad(np.abs(change), 2, mode="edge")
    beside = np.max([padded[k : k + len(change)] for k in (0, 1, 3, 4)], axis=0)
    turned = np.abs(np.abs(change) - 2 * np.pi) < 0.5  # a wrapped angle
    jumps = (np.abs(change) - 1.5 * beside > limit) & ~turned
    return np.asarray(np.where(jumps, change, 0.0))


CLEAN: Final = 0.01
"""Largest root mean square residual of a sinusoid, relative to its amplitude; the steps of a small
servo give 0.001 at 30°."""
CLEAN_RAD: Final = 1e-3
"""The same for a small amplitude: two thirds of a servo's step."""
PERIOD_FRACTION: Final = 0.3
"""Largest relative difference of the fitted period from the declared one."""
MOST_CYCLES: Final = 10
"""Most periods in a fit: they determine the period to 1e-4."""
MOST_ROWS: Final = 2000
"""Most rows in a fit; of more rows every nth is used."""
REPEATING: Final = 0.5
"""Smallest fraction of the variance of a sinusoid's goals with the declared period."""
PERIOD: Final = 0.005
"""Relative difference of the goals' period from the declared one that causes a warning."""
LEAST_STEPS: Final = 4
"""Fewest steps per period that samples resolve."""
GLIDE_S: Final = 1.2
"""Time at the end during which a motion may return to zero."""
UNLIKE: Final = 3.0
"""Factor by which another period must reduce the residual to be accepted."""


class SineFit(NamedTuple):
    """Sinusoid fitted to samples."""

    period_s: float
    sine: float  # Coefficients of sine and cosine, in the unit of the samples
    cosine: float
    residual: float  # Root mean square, in that unit

    @property
    def clean(self) -> bool:
        """Whether the samples are this sinusoid up to the resolution of a servo."""
        return self.residual <= max(CLEAN * float(np.hypot(self.sine, self.cosine)), CLEAN_RAD)


def fit_sine(time_s: Array, goal_rad: Array, period_s: float) -> SineFit:
    """Fit a sinusoid with a given period to goals (n,)."""
    phase = 2 * np.pi * (time_s - time_s[0]) / period_s
    design = np.column_stack([np.ones_like(phase), np.sin(phase), np.cos(phase)])
    terms, *_ = np.linalg.lstsq(design, goal_rad, rcond=None)
    left = float(np.sqrt(np.mean((goal_rad - design @ terms) ** 2)))
    return SineFit(period_s, float(terms[1]), float(terms[2]), left)


def fit_period(time_s: Array, goal_rad: Array, period_s: float) -> SineFit:
    """Fit a sinusoid with a period near the declared one to goals (n,) of at least one period."""
    first = time_s < time_s[0] + MOST_CYCLES * period_s
    every = int(first.sum()) // MOST_ROWS + 1
    time_s, goal_rad = time_s[first][::every], goal_rad[first][::every]
    cycles = (time_s[-1] - time_s[0]) / period_s
    count = int(np.ceil(20 * PERIOD_FRACTION * max(cycles, 1.0))) + 1
    tried = period_s * np.linspace(1 - PERIOD_FRACTION, 1 + PERIOD_FRACTION, count)
    best = int(np.argmin([fit_sine(time_s, goal_rad, own_s).residual for own_s in tried]))
    found = minimize_scalar(
        lambda own_s: fit_sine(time_s, goal_rad, own_s).residual, method="bounded",
        bounds=(tried[max(best - 1, 0)], tried[min(best + 1, count - 1)]),
        options={"xatol": 1e-6 * period_s},
    )  # fmt: skip
    return fit_sine(time_s, goal_rad, float(found.x))


def _sinusoid(trial: Trial) -> list[ImportFinding]:
    """Findings on the period of a sinusoid, and on a sinusoid under another name."""
    meta, rest = trial.meta, trial.meta.rest_samples
    goal, time_s, period_s = trial.goal_rad[rest:, 0], trial.time_s[rest:], trial.meta.period_s
    if meta.motion not in KINDS or len(goal) < 8 or goal.std() < LEAST_MOTION_RAD:
        return []
    # A motion may end with a return to zero, or continue at rest.
    whole_s = float(time_s[-1] - time_s[0])
    ends_s = [whole_s, whole_s - GLIDE_S, *((2 * period_s,) if 2 * period_s < whole_s else ())]
    windows = [time_s <= time_s[0] + end_s for end_s in ends_s if end_s >= 0.95 * period_s]
    windows = [w for w in windows if goal[w].std() > 0]
    residuals = [fit_sine(time_s[w], goal[w], period_s).residual / goal[w].std() for w in windows]
    sampled = period_s > LEAST_STEPS * trial.step_s
    is_sinusoid = meta.motion == "sinusoid"
    if is_sinusoid and not (sampled and 1 - min(residuals, default=0.0) ** 2 >= REPEATING):
        return causes.NO_SINUSOID.raised(period_s=period_s)
    if not sampled:
        return []
    fits = [(fit_period(time_s[w], goal[w], period_s), w) for w in windows]
    clean = [(fit, w) for fit, w in fits if fit.clean]
    if not clean:
        return []
    fit, window = clean[0]
    time_s, goal = time_s[window], goal[window]
    if not is_sinusoid:  # below one and a half periods it may be another motion
        is_long = time_s[-1] - time_s[0] >= 1.5 * fit.period_s
        return causes.MOTION.raised(period_s=fit.period_s, motion=meta.motion) if is_long else []
    off = fit.period_s / period_s - 1
    first = time_s <= time_s[0] + MOST_CYCLES * period_s
    stated = fit_sine(time_s[first], goal[first], period_s)
    if abs(off) <= PERIOD or stated.residual < UNLIKE * fit.residual:
        return []
    return causes.PERIOD.raised(period_s=fit.period_s, stated_s=period_s, off=abs(off))


SINUSOIDAL: Final = 0.9
"""Smallest fraction of a goal's variance in a sine of the period that defines its phase."""


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
    phases = []
    for goal in trial.goal_rad[cycle].T:
        fit = fit_sine(trial.time_s[cycle], goal, meta.period_s)
        if np.std(goal) < LEAST_MOTION_RAD or fit.residual**2 > (1 - SINUSOIDAL) * np.var(goal):
            return []
        phases.append(np.arctan2(fit.cosine, fit.sine))
    lead = float(phases[1] - phases[0])
    off = float(np.angle(np.exp(1j * (lead - meta.phase_2_rad))))
    shown = float(np.angle(np.exp(1j * (lead + 1e-9))))
    return causes.PHASE.beyond(off, lead_rad=shown, stated_rad=meta.phase_2_rad)
