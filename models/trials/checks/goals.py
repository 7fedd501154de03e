"""Sinusoids fitted to goals: with a free period, or with a jump of the phase.

Findings on goals against their angles and conditions: not moving, cut, or of another period.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from firmware_py.display_units import ANGLE
from firmware_py.motion import KINDS
from models.trials.checks.finding import ImportFinding
from models.trials.checks.motion import LARGEST_RAD, LEAST_MOTION_RAD
from models.trials.trial import Array, Trial

PERIOD_FRACTION: Final = 0.3
"""Largest relative difference of the fitted period from the declared one."""
CLEAN: Final = 0.01
"""Largest root mean square residual of a sinusoid, relative to its amplitude; the steps of a small
servo give 0.001 at 30°."""
CLEAN_RAD: Final = 1e-3
"""The same for a small amplitude: two thirds of a servo's step."""
LEAST_CYCLES: Final = 0.15
"""Shortest stretch on each side of a jump, in periods: a shorter one fits any phase."""
MOST_CYCLES: Final = 10
"""Most periods in a fit: they determine the period to 1e-4."""
MOST_ROWS: Final = 2000
"""Most rows in a fit; of more rows every nth is used."""
ALIKE: Final = 0.05
"""Largest relative difference between the amplitudes before and after a jump."""


class SineFit(NamedTuple):
    """Sinusoid fitted to samples."""

    period_s: float
    amplitude: float  # Amplitude, in the unit of the samples
    left: float  # Root mean square residual, in that unit

    @property
    def clean(self) -> bool:
        """Whether the samples are this sinusoid up to the resolution of a servo."""
        return self.left <= max(CLEAN * self.amplitude, CLEAN_RAD)


class PhaseLeap(NamedTuple):
    """Row at which a sinusoid continues with another phase."""

    row: int  # First row after the jump
    lead_s: float  # Time by which the phase jumps ahead; negative if it falls back


def fit_sine(time_s: Array, goal_rad: Array, period_s: float) -> SineFit:
    """Fit a sinusoid with a given period to goals (n,)."""
    phase = 2 * np.pi * (time_s - time_s[0]) / period_s
    design = np.column_stack([np.ones_like(phase), np.sin(phase), np.cos(phase)])
    terms, *_ = np.linalg.lstsq(design, goal_rad, rcond=None)
    left = float(np.sqrt(np.mean((goal_rad - design @ terms) ** 2)))
    return SineFit(period_s, float(np.hypot(terms[1], terms[2])), left)


def fit_period(time_s: Array, goal_rad: Array, period_s: float) -> SineFit:
    """Fit a sinusoid with a period near the declared one to goals (n,).

    The goals last at least one period; the first `MOST_CYCLES` periods are used.
    """
    first = time_s < time_s[0] + MOST_CYCLES * period_s
    time_s, goal_rad = time_s[first], goal_rad[first]
    every = len(time_s) // MOST_ROWS + 1
    time_s, goal_rad = time_s[::every], goal_rad[::every]
    cycles = (time_s[-1] - time_s[0]) / period_s
    count = int(np.ceil(20 * PERIOD_FRACTION * max(cycles, 1.0))) + 1
    tried = period_s * np.linspace(1 - PERIOD_FRACTION, 1 + PERIOD_FRACTION, count)
    best = int(np.argmin([fit_sine(time_s, goal_rad, own_s).left for own_s in tried]))
    bounds = tried[max(best - 1, 0)], tried[min(best + 1, count - 1)]
    found = minimize_scalar(
        lambda own_s: fit_sine(time_s, goal_rad, own_s).left, bounds=bounds, method="bounded",
        options={"xatol": 1e-6 * period_s},
    )  # fmt: skip
    return fit_sine(time_s, goal_rad, float(found.x))


def find_leap(time_s: Array, goal_rad: Array, period_s: float) -> PhaseLeap | None:
    """Row at which the phase of goals (n,) jumps within an otherwise unchanged sinusoid.

    None if there is no such row, or if the goals are no sinusoid on either side.
    """
    phase = 2 * np.pi * (time_s - time_s[0]) / period_s
    design = np.column_stack([np.ones_like(phase), np.sin(phase), np.cos(phase)])
    least = int(np.searchsorted(time_s, time_s[0] + LEAST_CYCLES * period_s))
    if len(time_s) < 2 * least + 1 or least < 8:
        return None

    def sides(row: int) -> tuple[Array, Array, float]:
        """Coefficients before and after a row, and the residual sum of squares of both."""
        parts = [(design[:row], goal_rad[:row]), (design[row:], goal_rad[row:])]
        terms = [np.linalg.lstsq(d, g, rcond=None)[0] for d, g in parts]
        left = sum(np.sum((g - d @ t) ** 2) for (d, g), t in zip(parts, terms, strict=True))
        return terms[0], terms[1], float(left)

    stride = max((len(time_s) - 2 * least) // 60, 1)
    coarse = range(least, len(time_s) - least + 1, stride)
    near = min(coarse, key=lambda row: sides(row)[2])
    fine = range(max(near - stride, least), min(near + stride, len(time_s) - least) + 1)
    row = min(fine, key=lambda own: sides(own)[2])
    before, behind, left = sides(row)
    sizes = np.hypot(before[1], before[2]), np.hypot(behind[1], behind[2])
    mean = 0.5 * (sizes[0] + sizes[1])
    clean = SineFit(period_s, mean, float(np.sqrt(left / len(time_s)))).clean
    if not clean or abs(sizes[0] - sizes[1]) > ALIKE * mean:
        return None
    turn = np.arctan2(behind[2], behind[1]) - np.arctan2(before[2], before[1])
    lead = float(np.angle(np.exp(1j * turn)))
    return PhaseLeap(row, lead / (2 * np.pi) * period_s)


REPEATING: Final = 0.5
"""Smallest fraction of the variance of a sinusoid's goals with the declared period."""
PERIOD: Final = 0.005
"""Relative difference of the goals' period from the declared one that causes a warning."""
LEAST_STEPS: Final = 4
"""Fewest steps per period that samples resolve."""
GLIDE_S: Final = 1.2
"""Time at the end during which a motion may return to zero."""
LEAP_RAD: Final = 0.06
"""Jump of the goals' phase that causes a warning: two to three rows of the study's motion."""
UNLIKE: Final = 3.0
"""Factor by which another period must reduce the residual to be accepted."""
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
    found = [*judge_standing_goals(trial), *_jump(trial)]
    return found or _period(trial)


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
            return [
                ImportFinding(
                    "refused", "goal",
                    f"angle_{j}_rad moves by {ANGLE.text(np.ptp(angle))} while goal_{j}_rad {only}",
                    "give the goals that were sent, or set amplitude_rad = 0 where the joint was "
                    "moved by hand",
                )
            ]  # fmt: skip
    if not np.ptp(trial.goal_rad, axis=0).any():
        return [
            ImportFinding(
                "warning", "amplitude",
                f"the goals stand still, amplitude_rad says {ANGLE.significant(declared)}",
                "correct amplitude_rad, or give the goals that were sent",
            )
        ]  # fmt: skip
    return []


def _jump(trial: Trial) -> list[ImportFinding]:
    """Finding on a row in which goal and angle jump together, as an angle lags its goal."""
    if trial.step_s > LONGEST_STEP_S or len(trial) < 8:
        return []
    for j in range(trial.meta.dof):
        goal, angle = (_jumps(values[:, j]) for values in (trial.goal_rad, trial.angle_rad))
        at = np.flatnonzero(goal * angle > 0)
        if len(at):
            row = int(at[np.argmax(np.abs(angle[at]))])
            return [
                ImportFinding(
                    "warning", "gap",
                    f"goal_{j + 1}_rad and angle_{j + 1}_rad jump together by "
                    f"{ANGLE.text(angle[row])} in row {row + 3} ({trial.time_s[row + 1]:.2f} s), "
                    "no angle follows its goal so fast: rows are missing before it",
                    "give the rows that are missing with their own times, or cut the trial there",
                )
            ]  # fmt: skip
    return []


def _jumps(values: Array) -> Array:
    """Changes from row to row, (n - 1,), that differ much from adjacent ones; else zero."""
    change = np.diff(values)
    apart = np.abs(np.diff(change))
    limit = max(JUMP_RAD, JUMP_NOISE * float(np.median(apart)))
    padded = np.pad(np.abs(change), 2, mode="edge")
    count = len(change)
    beside = np.max([padded[k : k + count] for k in (0, 1, 3, 4)], axis=0)
    turned = np.abs(np.abs(change) - 2 * np.pi) < 0.5  # a wrapped angle
    jumps = (np.abs(change) - 1.5 * beside > limit) & ~turned
    return np.asarray(np.where(jumps, change, 0.0))


def _period(trial: Trial) -> list[ImportFinding]:
    """Finding on the period of a sinusoid, on a jump of its phase, and on the motion's name."""
    meta, rest = trial.meta, trial.meta.rest_samples
    goal, time_s = trial.goal_rad[rest:, 0], trial.time_s[rest:]
    if meta.motion not in KINDS or len(goal) < 8 or goal.std() < LEAST_MOTION_RAD:
        return []
    whole_s, period_s = float(time_s[-1] - time_s[0]), meta.period_s
    # A motion may end with a return to zero, or continue at rest.
    ends_s = [whole_s, whole_s - GLIDE_S, *((2 * period_s,) if 2 * period_s < whole_s else ())]
    kept = [time_s <= time_s[0] + end_s for end_s in ends_s if end_s >= 0.95 * period_s]
    parts = [
        1 - (fit_sine(time_s[k], goal[k], period_s).left / goal[k].std()) ** 2
        for k in kept if goal[k].std() > 0
    ]  # fmt: skip
    sampled = period_s > LEAST_STEPS * trial.step_s
    if meta.motion == "sinusoid" and not (sampled and max(parts, default=1.0) >= REPEATING):
        return [
            ImportFinding(
                "warning", "period",
                f"the goals are no sinusoid with the period of {period_s:g} s",
                "correct period_s or motion under [trial]",
            )
        ]  # fmt: skip
    if not sampled:
        return []
    fits = [fit_period(time_s[k], goal[k], period_s) for k in kept]
    clean = next((k for k, fit in enumerate(fits) if fit.clean), None)
    if clean is not None:
        own = time_s[kept[clean]], goal[kept[clean]]
        told = _other_period if meta.motion == "sinusoid" else _other_motion
        return told(trial, *own, fits[clean].period_s, fits[clean].left)
    return _leap(trial, [(time_s[k], goal[k]) for k in kept])


def _other_motion(
    trial: Trial, time_s: Array, goal: Array, period_s: float, left: float
) -> list[ImportFinding]:
    """Finding on a sinusoid under another name; below one and a half periods it may be either."""
    if time_s[-1] - time_s[0] < 1.5 * period_s:
        return []
    return [
        ImportFinding(
            "warning", "motion",
            f"the goals are a sinusoid of {period_s:.3f} s, motion says {trial.meta.motion!r}",
            'set motion = "sinusoid"',
        )
    ]  # fmt: skip


def _other_period(
    trial: Trial, time_s: Array, goal: Array, period_s: float, left: float
) -> list[ImportFinding]:
    """Finding on a sinusoid whose period differs from the conditions."""
    declared_s = trial.meta.period_s
    off = period_s / declared_s - 1
    first = time_s <= time_s[0] + 10 * declared_s
    as_declared = fit_sine(time_s[first], goal[first], declared_s).left
    if abs(off) <= PERIOD or as_declared < UNLIKE * left:
        return []
    return [
        ImportFinding(
            "warning", "period",
            f"the goals repeat after {period_s:.3f} s, period_s says {declared_s:.3f} s: the time "
            f"step or period_s is wrong by {abs(off):.1%}",
            "correct period_s, or the step and the unit of the times",
        )
    ]  # fmt: skip


def _leap(trial: Trial, windows: list[tuple[Array, Array]]) -> list[ImportFinding]:
    """Finding on a sinusoid whose phase jumps."""
    if trial.meta.motion != "sinusoid":
        return []
    period_s, rest = trial.meta.period_s, trial.meta.rest_samples
    for time_s, goal in windows:
        leap = find_leap(time_s, goal, period_s)
        if leap is None or abs(leap.lead_s) < LEAP_RAD / (2 * np.pi) * period_s:
            continue
        lead = f"{abs(leap.lead_s):.3f} s {'ahead' if leap.lead_s > 0 else 'back'}"
        why = "rows are missing" if leap.lead_s > 0 else "rows stand twice"
        row = rest + leap.row
        return [
            ImportFinding(
                "warning", "gap",
                f"the goals leap {lead} near row {row + 2} ({trial.time_s[row]:.2f} s): {why}",
                "give all rows once with their own times, or cut the trial there",
            )
        ]  # fmt: skip
    return []
