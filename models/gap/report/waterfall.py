"""Waterfall: error on trials that no value was fitted to, after each inclusion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from models.gap.diagnosis import Diagnosis, all_fit_parameters
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.normal_equation import mean_square
from models.gap.residuals.residuals import Residuals
from models.plant.identification.noise_floor import Array
from models.trials.trial import Trial, TrialSet


def waterfall_steps(found: Diagnosis, trials: TrialSet) -> list[tuple[str, float]]:
    """Error on held-out trials, in noise floors: of the diagnosed plant, then after each fit.

    Common fit parameters are fitted to the trials of the study's split and then fixed. On the
    held-out trials only the variation between trials is fitted, within its prior. It starts from
    the fitted variation of the trials with the same payload, since a large gap that is not yet
    explained distorts it.
    """
    fit, held_out = trials.split()
    fitted, tested = (_estimator(found, t.trials) for t in (fit, held_out if held_out else fit))
    steps, parameters = found.settings.waterfall_steps, fitted.residuals.fit_parameters
    point = fitted.start()
    result = [("plant as given", _floors(tested, point.values, fitted))]
    named: list[str] = []
    for label, effects in [("nuisance refitted", []), *((e, [e]) for e in found.named)]:
        named += effects
        start = point.values.copy()
        for effect in effects:
            own = [k for k, q in enumerate(parameters) if q.effect == effect]
            here = [k for k, q in enumerate(found.fit_parameters) if q.effect == effect]
            start[own] = found.fitted_values[here]
        free = np.array([q.kind != "effect" or q.effect in named for q in parameters])
        nearest = min([fitted.at(start), point], key=lambda p: p.cost)
        point = fitted.fit(nearest, free, steps, found.settings.waterfall_relative_fall)
        result.append((label.replace("_", " "), _floors(tested, point.values, fitted)))
    result.append(("noise floor", 1.0))
    return result


def _estimator(found: Diagnosis, trials: Sequence[Trial]) -> GaussNewton:
    """Estimator of nuisance, variation and the named effects, in the catalogue's order."""
    catalogue = dict.fromkeys(q.effect for q in found.fit_parameters if q.effect in found.named)
    parameters = all_fit_parameters(found.plant, trials, list(catalogue), found.settings)
    return GaussNewton(Residuals(found.plant, trials, parameters, found.settings), found.floor)


def _floors(tested: GaussNewton, values: Array, fitted: GaussNewton) -> float:
    """Root mean square in noise floors with the common fit parameters of another estimator."""
    settings = tested.settings
    variation = np.array([q.kind == "trial" for q in tested.residuals.fit_parameters])
    start = tested.at(_handed_over(tested, values, fitted))
    point = tested.fit(start, variation, settings.waterfall_steps, settings.waterfall_relative_fall)
    return float(np.sqrt(mean_square(tested.whitened(point.rows))))


def _handed_over(tested: GaussNewton, values: Array, fitted: GaussNewton) -> Array:
    """Fitted values for another estimator: common ones by name, those of a trial by name and
    payload.
    """
    by_key = dict(zip(_keys(fitted.residuals), values, strict=True))
    return np.array([by_key.get(key, 0.0) for key in _keys(tested.residuals)])


def _keys(residuals: Residuals) -> list[tuple[str, float | None, int]]:
    """Name, payload and number of every fit parameter: a name may occur once for each axis."""
    seen: Counter[tuple[str, int | None]] = Counter()
    result = []
    for q in residuals.fit_parameters:
        payload_kg = None if q.trial is None else residuals.trials[q.trial].meta.payload_kg
        result.append((q.name, payload_kg, seen[q.name, q.trial]))
        seen[q.name, q.trial] += 1
    return result
