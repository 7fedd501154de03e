"""Value and rate of a measured column at the start of a trial that may begin in motion."""

from __future__ import annotations

from typing import Final

import numpy as np

from models.trials.trial import Trial

__all__ = ["start_of_motion"]

LONGEST_START_S: Final = 0.05
"""Longest window at the start: a quarter of a period at 5 Hz."""

LEAST_ROWS: Final = 5
"""Rows of the shortest window."""

CONFIDENCE_SD: Final = 2.0
"""Half-width of a rate's confidence interval in standard deviations [Katkovnik 1999: 1.5 to 3]."""


def start_of_motion(trial: Trial, column: str) -> tuple[float, float]:
    """Value and rate of a column at the first row, by a parabola through its first rows.

    A long window averages noise, a short one follows a jerk. The longest window is used whose rate
    agrees with that of every shorter one: intersection of confidence intervals [Goldenshluger &
    Nemirovski 1997; Katkovnik 1999]. The noise is estimated from the third differences, which a
    smooth motion hardly has.
    """
    longest = min(max(LEAST_ROWS, round(LONGEST_START_S / trial.step_s)), len(trial))
    time_s, values = trial.time_s[:longest] - trial.time_s[0], trial.columns[column][:longest]
    seen = np.isfinite(values)
    time_s, values = time_s[seen], values[seen]
    if len(values) < LEAST_ROWS:
        return 0.0, 0.0
    noise = float(np.sqrt(np.mean(np.diff(values, 3) ** 2) / 20))  # 1 + 9 + 9 + 1
    low, high, chosen = -np.inf, np.inf, (0.0, 0.0)
    for rows in range(LEAST_ROWS, len(values) + 1):
        powers = np.vander(time_s[:rows] / time_s[rows - 1], 3, increasing=True)
        inverse = np.linalg.pinv(powers)
        value, slope, _ = inverse @ values[:rows]
        rate = slope / time_s[rows - 1]
        error = CONFIDENCE_SD * noise * float(np.linalg.norm(inverse[1])) / time_s[rows - 1]
        low, high = max(low, rate - error), min(high, rate + error)
        if low > high:
            break
        chosen = float(value), float(rate)
    return chosen
