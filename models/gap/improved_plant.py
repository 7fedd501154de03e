"""Plant with the named effects and the refitted nuisance."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.plant.effects import EFFECTS
from models.plant.plant import Plant
from models.plant.provenance import Provenance
from models.trials.trial import TrialSet


def improved_plant(
    plant: Plant, search: EffectSearch, result: SearchResult, trials: TrialSet
) -> Plant:
    """Plant with the named effects and the refitted nuisance, its parentage in the provenance.

    Where nothing was named the values stay as they are.

    Parameters
    ----------
    plant : Plant
        As given.
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run.
    trials : TrialSet
        Where the gap was looked for.
    """
    origin = plant.provenance
    if result.named:
        origin = Provenance(noise_floor=plant.provenance.noise_floor)
    origin = msgspec.structs.replace(
        origin,
        parent_sha256=plant.sha256(),
        data_sha256=trials.sha256(),
        fitted_trials=plant.provenance.fitted_with(trials),
        named=tuple(result.named),
    )
    if not result.named:
        return replace(plant, provenance=origin)
    full = plant.with_effects(*result.named)
    changed, uncertain = _refitted(full, search, result)
    name = f"{plant.name.removesuffix(', gap closed')}, gap closed"
    return replace(full.with_values(changed, uncertain), name=name, provenance=origin)


def _refitted(
    full: Plant, search: EffectSearch, result: SearchResult
) -> tuple[dict[str, float], dict[str, float]]:
    """Value and standard error of every parameter that was fitted for all trials."""
    free, values, settings = search.free(result.named), result.after.values, search.settings
    covariance = search.estimator.covariance(result.after, free)
    errors = np.zeros(len(values))
    dispersion = np.sqrt(search.dispersion(result.after))
    errors[np.flatnonzero(free)] = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * dispersion
    changed: dict[str, float] = {}
    uncertain: dict[str, float] = {}
    for k, direction in enumerate(search.fit_parameters):
        if direction.trial is not None or not free[k]:
            continue
        missed = 0.0
        if direction.effect:
            port = EFFECTS[direction.effect].port
            by_port, general = (
                settings.strength_error_fraction_by_port, settings.strength_error_fraction
            )  # fmt: skip
            missed = by_port.get(port, general) * values[k]
        for name, weight in direction.parameters.items():
            if name not in full.parameters:
                continue
            q = full.parameters[name]
            value = changed.get(name, q.value) + weight * values[k]
            changed[name] = float(np.clip(value, q.low, q.high))
            parts = uncertain.get(name, 0.0), weight * errors[k], weight * missed
            uncertain[name] = float(np.hypot(np.hypot(*parts[:2]), parts[2]))
    return changed, uncertain
