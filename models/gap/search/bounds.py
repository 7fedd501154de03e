"""Bounds of fitted values: a strength at a bound names nothing, another value is left as given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton, Mask
from models.gap.residuals.fit_parameters import plant_with_searched_effects, written_values
from models.plant.parameter import AT_BOUND, impossible_sums

FIT_STEPS: Final = 8
"""Most steps of a fit with a value that is left as given [assumed]."""


def within_bounds(
    estimator: GaussNewton, here: FitPoint, point: FitPoint, free: Mask, added: Sequence[str]
) -> tuple[FitPoint, Mask] | None:
    """Fit whose values are inside of their bounds, with the fit parameters that are free in it.

    Other parameters of the added candidates that ended at a bound keep the plant's value, and the
    rest is fitted again. None where a strength of theirs ended at a bound or at zero, where the
    plant would be none that can exist, or where nothing is gained over `here`, the fit without
    them.

    Shapes: `free` (p,).
    """
    parameters = estimator.residuals.fit_parameters
    of_effects = [k for k, q in enumerate(parameters) if q.effect in added]
    while True:
        at = [k for k in of_effects if free[k] and is_at_bound(estimator, point, k)]
        strengths = [k for k in of_effects if parameters[k].is_strength]
        if any(parameters[k].is_strength for k in at) or _vanishes(estimator, point, strengths):
            return None
        if not at:
            break
        free, values = free.copy(), point.values.copy()
        free[at[0]], values[at[0]] = False, 0.0
        start = min([estimator.at(values), here], key=lambda p: p.cost)
        point = estimator.fit(start, free, FIT_STEPS)
    if point.cost >= here.cost or _is_impossible(estimator, point, free):
        return None
    return point, free


def is_at_bound(estimator: GaussNewton, point: FitPoint, k: int) -> bool:
    """Whether a fitted value moved to a bound of its own."""
    low, high = estimator.low[k], estimator.high[k]
    near, value = AT_BOUND * (high - low), point.values[k]
    return bool(np.isfinite(near)) and bool(min(value - low, high - value) <= near < abs(value))


def _vanishes(estimator: GaussNewton, point: FitPoint, strengths: Sequence[int]) -> bool:
    """Whether all strengths of some candidates are zero."""
    ranges = [AT_BOUND * (estimator.high[k] - estimator.low[k]) for k in strengths]
    return all(abs(point.values[k]) <= near for k, near in zip(strengths, ranges, strict=True))


def _is_impossible(estimator: GaussNewton, point: FitPoint, free: Mask) -> bool:
    """Whether the fitted plant would have a sum that no real body has, and the given one has
    not.
    """
    residuals = estimator.residuals
    plant, payloads_kg = residuals.plant, [t.meta.payload_kg for t in residuals.trials]
    fit_parameters = residuals.fit_parameters
    names = [
        q.effect for q, fitted in zip(fit_parameters, free, strict=True) if q.effect and fitted
    ]
    full = plant_with_searched_effects(plant, names)
    fitted = full.with_values(written_values(full, fit_parameters, point.values, free))
    before, after = (
        {
            row.what
            for row in impossible_sums({n: q.value for n, q in parameters.items()}, payloads_kg)
        }
        for parameters in (plant.parameters, fitted.parameters)
    )
    return bool(after - before)
