"""Standard errors that allow for correlated model error: jackknife over groups of rows.

The curvature of the cost treats residuals as independent noise. But the error of a reduced model is
alike in rows of one payload, or of one part of the motion, however many they are. The fit is
therefore repeated, linearised, with one group of rows left out at a time::

    d_g = (H − H_g)⁻¹ s_g,   H = J'J with priors,  H_g = J_g'J_g,  s_g = J_g'r_g
    V = (G − 1)/G Σ (d_g − mean d)²

(delete-a-group jackknife [Efron & Tibshirani 1993]; with few groups the sandwich estimate is too
small [Cameron & Miller 2015]). G groups give G − 1 degrees of freedom: the error is widened so that
twice the error is a 95 % interval of Student's t. Rows are grouped by payload (by trial if there
are fewer than three payloads) and by part of the motion. The larger variance is added to that of
the curvature.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from models.trials.trial import Trial

__all__ = ["Group", "cluster_errors", "grouped_rows", "jackknife_variance", "motion_parts"]

Array = NDArray[np.float64]

LEAST_GROUPS: Final = 3
"""Fewest groups whose scatter is used [assumed]."""

TWO_SIDED: Final = 0.975


class Group(NamedTuple):
    """Rows that are left out together."""

    information: Array  # (k, k), J'J of the rows
    score: Array  # (k,), J'r of the rows


def motion_parts(trial: Trial) -> NDArray[np.int_]:
    """Part of the motion that each row belongs to: signs of angle and rate of the first joint.

    Returns shape (n,), 0 to 3; zeros if no angle or position of the first joint was measured.
    """
    for name in ("angle_1_rad", "position_1_m"):
        if name in trial.columns and len(trial) > 1:
            angle = trial.columns[name] - np.nanmean(trial.columns[name])
            return np.asarray(2 * (angle > 0) + (np.gradient(angle) > 0), dtype=np.int_)
    return np.zeros(len(trial), dtype=int)


Rows = tuple[Trial, NDArray[np.bool_], Array, Array]
"""Trial, mask of its measured rows, and their residuals (n,) and Jacobian (n, k)."""


def grouped_rows(rows: Sequence[Rows]) -> tuple[dict[Hashable, Group], dict[Hashable, Group]]:
    """Group the rows by payload (by trial if payloads are few), and by part of the motion."""
    few = len({trial.meta.payload_kg for trial, *_ in rows}) < LEAST_GROUPS
    by_load: dict[Hashable, Group] = {}
    by_part: dict[Hashable, Group] = {}
    for trial, seen, residual, jacobian in rows:
        _add_rows(by_load, trial.name if few else trial.meta.payload_kg, residual, jacobian)
        part = motion_parts(trial)[seen]
        for number in np.unique(part):
            own = part == number
            _add_rows(by_part, int(number), residual[own], jacobian[own])
    return by_load, by_part


def _add_rows(
    groups: dict[Hashable, Group], key: Hashable, residual: Array, jacobian: Array
) -> None:
    information, score = jacobian.T @ jacobian, jacobian.T @ residual
    if key in groups:
        information, score = information + groups[key].information, score + groups[key].score
    groups[key] = Group(information, score)


def jackknife_variance(
    groups: Sequence[Group], information: Array, low: Array, high: Array
) -> Array:
    """Variance of each parameter, leaving one group out at a time; zero for too few groups.

    `information` has shape (k, k). `low` and `high` (k,) are the largest changes of each parameter
    down and up, because a refit stays within the bounds.
    """
    count = len(groups)
    if count < LEAST_GROUPS:
        return np.zeros(len(information))
    changes = np.array(
        [np.linalg.lstsq(information - g.information, g.score, rcond=1e-12)[0] for g in groups]
    )
    changes = np.clip(changes, low, high)
    scatter = np.sum((changes - changes.mean(axis=0)) ** 2, axis=0) * (count - 1) / count
    widened = float(student_t.ppf(TWO_SIDED, count - 1)) / 2.0
    return np.asarray(scatter * max(widened, 1.0) ** 2)


def cluster_errors(
    groupings: Sequence[Mapping[Hashable, Group]], information: Array, low: Array, high: Array
) -> Array:
    """Standard errors from the curvature and the grouping with the larger variance together.

    Arguments as for `jackknife_variance`. A parameter at a bound (no room on one side) is left out
    of the jackknife and has the error of the curvature alone.
    """
    curvature = np.diag(np.linalg.pinv(information, hermitian=True))
    free = np.flatnonzero((low < 0) & (high > 0))
    largest = np.zeros(len(information))
    for groups in groupings:
        own = [Group(g.information[np.ix_(free, free)], g.score[free]) for g in groups.values()]
        variance = jackknife_variance(own, information[np.ix_(free, free)], low[free], high[free])
        largest[free] = np.maximum(largest[free], variance)
    return np.asarray(np.sqrt(curvature + largest))
