"""Plant with the named effects and the refitted nuisance."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import msgspec
import numpy as np

from models.gap.decision.certainty import read_certainty
from models.gap.decision.written_fit import WrittenFit
from models.gap.estimation.gauss_newton import FitPoint, GaussNewton, Mask
from models.gap.residuals.fit_parameters import (
    moved_in_plant,
    plant_with_searched_effects,
    written_values,
)
from models.gap.search.effect_search import EffectSearch, SetFit
from models.plant.document import Provenance
from models.plant.plant import Plant
from models.plant.step_model import Array
from models.shared.catalogue import effect_and_joint
from models.trials.trial import TrialSet


def improved_plant(
    plant: Plant, search: EffectSearch, fit: SetFit | WrittenFit, trials: TrialSet
) -> Plant:
    """Plant with the effects of a fit and its nuisance; its provenance names its parent.

    The values do not change where nothing is free in the fit.
    """
    origin = plant.provenance
    written = bool(np.any(fit.free))
    named = list(dict.fromkeys(effect_and_joint(c)[0] for c in fit.candidates))
    if written:
        provenance = plant.provenance
        origin = Provenance(noise_floor=provenance.noise_floor, servo_gains=provenance.servo_gains)
    origin = msgspec.structs.replace(
        origin,
        parent_sha256=plant.sha256(),
        data_sha256=trials.sha256(),
        fitted_trials=plant.provenance.fitted_with(trials),
        named=tuple(named),
    )
    if not written:
        return replace(plant, provenance=origin)
    full = plant_with_searched_effects(plant, named)
    parameters = search.estimator.residuals.fit_parameters
    changed = written_values(full, parameters, fit.point.values, fit.free)
    uncertain = _standard_errors(full, search.estimator, fit.point, fit.free)
    done = "effects added" if named else "refitted"
    name = f"{plant.name.removesuffix(f', {done}')}, {done}"
    return replace(full.with_values(changed, uncertain), name=name, provenance=origin)


def _standard_errors(
    full: Plant, estimator: GaussNewton, point: FitPoint, free: Mask
) -> dict[str, float]:
    """Standard error of every plant parameter that was fitted.

    An effect and a nuisance may move the same parameter: their sum is known better than each of
    them. The error of an effect's equation adds to that of noise.
    """
    values, certainty = point.values, read_certainty()
    parameters = estimator.residuals.fit_parameters
    fitted = np.flatnonzero(free)
    covariance = estimator.covariance(point, free) * max(estimator.mean_square(point), 1.0)
    weights: dict[str, Array] = defaultdict(lambda: np.zeros(len(values)))
    missed: dict[str, float] = defaultdict(float)
    for k, name, weight in moved_in_plant(full, parameters, free):
        weights[name][k] += weight
        if candidate := parameters[k].effect:
            error = certainty.error_of_strength(effect_and_joint(candidate)[0])
            missed[name] += float(error * weight * values[k]) ** 2
    chance = {n: max(float(w[fitted] @ covariance @ w[fitted]), 0.0) for n, w in weights.items()}
    return {name: (variance + missed[name]) ** 0.5 for name, variance in chance.items()}
