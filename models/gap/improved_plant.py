"""Plant with the named effects and the refitted nuisance."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import msgspec
import numpy as np

from models.gap.equation_error import read_equation_error
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.residuals.fit_parameters import FitParameter, plant_with_searched_effects
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.plant.document import Provenance
from models.plant.identification.noise_floor import Array
from models.plant.plant import Plant
from models.trials.trial import TrialSet


def improved_plant(
    plant: Plant,
    search: EffectSearch,
    result: SearchResult,
    point: FitPoint,
    free: Array,
    trials: TrialSet,
) -> Plant:
    """Plant with the named effects and the refitted nuisance; its provenance names its parent.

    The values do not change where nothing was named on an unchanged link, or where no named effect
    may be written. Of several named effects only those with free parameters are written.

    Shapes: `free` (p,).
    """
    origin = plant.provenance
    written = bool(np.any(free))
    named = [e for e in result.named if np.any(free & search.of[e])]
    if written:
        given = plant.provenance
        origin = Provenance(noise_floor=given.noise_floor, servo_gains=given.servo_gains)
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
    changed = written_values(full, search.fit_parameters, point.values, free)
    uncertain = _standard_errors(full, search, point, free)
    done = "gap closed" if named else "refitted"
    name = f"{plant.name.removesuffix(f', {done}')}, {done}"
    return replace(full.with_values(changed, uncertain), name=name, provenance=origin)


def written_values(
    full: Plant, fit_parameters: Sequence[FitParameter], values: Array, free: Array
) -> dict[str, float]:
    """Values of the plant's parameters that were fitted for all trials.

    Shapes: `values` (p,), `free` (p,).
    """
    changed: dict[str, float] = {}
    for k, name, weight in _moved(full, fit_parameters, free):
        q = full.parameters[name]
        value = changed.get(name, q.value) + weight * values[k]
        changed[name] = float(np.clip(value, q.low, q.high))
    return changed


def _moved(
    full: Plant, fit_parameters: Sequence[FitParameter], free: Array
) -> Iterator[tuple[int, str, float]]:
    """Index of each fit parameter common to all trials, the plant parameter it moves, and its
    weight.
    """
    for k, direction in enumerate(fit_parameters):
        if direction.trial is None and free[k]:
            for name, weight in direction.parameters.items():
                if name in full.parameters:
                    yield k, name, weight


def _standard_errors(
    full: Plant, search: EffectSearch, point: FitPoint, free: Array
) -> dict[str, float]:
    """Standard error of every plant parameter that was fitted.

    An effect and a nuisance may move the same parameter: their sum is known better than each of
    them.
    """
    values, equation_error = point.values, read_equation_error()
    fitted = np.flatnonzero(free)
    covariance = search.estimator.covariance(point, free) * search.dispersion(point)
    weights: dict[str, Array] = defaultdict(lambda: np.zeros(len(values)))
    missed: dict[str, float] = defaultdict(float)
    for k, name, weight in _moved(full, search.fit_parameters, free):
        weights[name][k] += weight
        if effect := search.fit_parameters[k].effect:
            missed[name] += float(equation_error.fraction(effect) * weight * values[k]) ** 2
    chance = {n: max(float(w[fitted] @ covariance @ w[fitted]), 0.0) for n, w in weights.items()}
    return {name: (variance + missed[name]) ** 0.5 for name, variance in chance.items()}
