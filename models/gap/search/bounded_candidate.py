"""Candidate of the effect search whose values are inside their bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.residuals.fit_parameters import plant_with_every_effect
from models.gap.search.candidate import Candidate
from models.gap.search.refused_effect import RefusedEffect, refusal_of_value, values_at_bounds
from models.plant.identification.noise_floor import Array


def bounded_candidate(
    estimator: GaussNewton,
    candidate: Candidate,
    here: FitPoint,
    free: Array,
    refused: list[RefusedEffect],
) -> Candidate | None:
    """Candidate within its bounds; None where its strength ended at one, or nothing is gained.

    Other parameters of the effect that ended at a bound keep the plant's value, and the rest is
    fitted again. A strength that ended at a bound adds an entry to `refused`.
    """
    parameters = estimator.residuals.fit_parameters
    strengths = strength_names(estimator, candidate.effects)
    own = free & np.array([q.effect in candidate.effects for q in parameters])
    while own.any():
        offending = values_at_bounds(
            estimator.residuals.plant, parameters, candidate.point, own, estimator.settings
        )
        if not offending:
            break
        for row in offending:
            if row.name in strengths:
                name = " + ".join(candidate.effects)
                refused.append(refusal_of_value(name, "at a bound", row))
                return None
        index = list(offending[0].index)
        own[index], free = False, free.copy()
        free[index] = False
        values = candidate.point.values.copy()
        values[index] = 0.0
        start = estimator.at(values)
        best = min([start, here], key=lambda p: p.cost)
        point = estimator.fit(best, free, estimator.settings.candidate_fit_steps)
        candidate = replace(
            candidate, point=point, gain=here.cost - point.cost, held=candidate.held | set(index)
        )
    return candidate if candidate.gain > 0 else None


def strength_names(estimator: GaussNewton, effects: tuple[str, ...]) -> set[str]:
    residuals = estimator.residuals
    full, dof = plant_with_every_effect(residuals.plant), residuals.trials[0].meta.dof
    return {name for effect in effects for name in full.strengths(effect, dof)}
