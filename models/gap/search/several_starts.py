"""Fits of an effect from several starts, because the cost has local minima."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.plant.identification.noise_floor import Array


def refitted_from_both_signs(
    estimator: GaussNewton, screened: FitPoint, here: FitPoint, free: Array, own: Array
) -> FitPoint:
    """Fit from a screened start, from zero and from the other sign.

    The present fit is among the starts, so the cost of a nested model never rises. Parameters that
    are `fitted_last` are freed where the others ended.

    `free` and `own`, shape (p,): fit parameters that are fitted, and those of the effect among
    them.
    """
    settings = estimator.settings
    starts = [screened]
    mirrored = screened.values.copy()
    mirrored[own] = np.clip(-mirrored[own], estimator.low[own], estimator.high[own])
    if np.any(mirrored != screened.values):
        starts.append(estimator.carry(here, estimator.at(mirrored)))
    last = np.array([q.fitted_last for q in estimator.residuals.fit_parameters])
    first = [
        estimator.fit(start, free & ~last, settings.candidate_start_steps)
        for start in starts
        if start.cost < np.inf
    ]
    best = min([here, *first], key=lambda p: p.cost)
    most = settings.candidate_fit_steps, settings.candidate_relative_fall
    best = estimator.fit(best, free & ~last, *most)
    return estimator.fit(best, free, *most) if np.any(free & last) else best


def refitted_from_far_strengths(
    estimator: GaussNewton,
    chosen: FitPoint,
    here: FitPoint,
    free: Array,
    strengths: Sequence[int],
    is_open: Callable[[FitPoint], bool],
) -> FitPoint:
    """Fit of a candidate; where the residual stays large, also from strengths far from the
    search's.

    A delay and friction that compensate each other form separate minima of the cost, and no step
    leads from one to the next.

    `chosen` and `here`: fit of the candidate so far, and the fit without it. `is_open`: whether the
    residual is large enough to try more starts.

    Shapes: `free` (p,).
    """
    settings = estimator.settings
    best = estimator.fit(chosen, free, settings.nuisance_fit_steps)
    if not is_open(best):
        return best
    ends = [best]
    for k, fraction in itertools.product(strengths, settings.restart_bound_fractions):
        parameter, values = estimator.residuals.fit_parameters[k], best.values.copy()
        values[k] = fraction * (parameter.high if fraction > 0 else -parameter.low)
        start = estimator.at(values)
        if start.cost < np.inf:
            carried = estimator.carry(here, start)
            ends.append(estimator.fit(carried, free, settings.restart_steps))
    nearest = min(ends, key=lambda p: p.cost)
    return best if nearest is best else estimator.fit(nearest, free, settings.nuisance_fit_steps)
