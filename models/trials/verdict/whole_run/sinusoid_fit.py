"""Sinusoids fitted to goals: with a free period, or with a jump of the phase."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from models.trials.trial import Array

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
