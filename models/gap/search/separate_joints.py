"""Difference of the joints: an effect of one servo, which no common strength explains.

Every effect first has one strength for all joints (`GapSettings.separate_joints`). The search with
one strength is given up where its best effect leaves a gap and, by derivatives, an effect with a
strength for each joint would explain much more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.residuals.fit_parameters import FitParameter
from models.gap.residuals.residuals import Residuals
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch


def joints_differ(
    search: EffectSearch, found: SearchResult, separate: Sequence[FitParameter]
) -> bool:
    """Whether effects with a strength for each joint explain much more than those with one.

    `search` has completed its first round with one strength; `separate` holds the same fit
    parameters with a strength for each joint.
    """
    best = max(found.rounds[0], key=lambda c: c.gain, default=None)
    if best is None or not search.has_gap(best.point):
        return False
    together = max(best.gain, _predicted_fall(search.estimator, found.before))
    residuals = search.estimator.residuals
    own = Residuals(residuals.plant, residuals.trials, separate, residuals.settings)
    estimator = GaussNewton(own, search.estimator.floor)
    known = {
        (q.name, q.trial): value
        for q, value in zip(search.fit_parameters, found.before.values, strict=True)
    }
    values = [0.0 if q.kind == "effect" else known[q.name, q.trial] for q in separate]
    alone = _predicted_fall(estimator, estimator.at(np.array(values)))
    return alone > search.settings.separate_joints_gain_ratio * together


def _predicted_fall(estimator: GaussNewton, point: FitPoint) -> float:
    """Largest fall of the cost that derivatives predict for one effect beside the nuisance."""
    estimator.linearise(point)
    parameters = estimator.residuals.fit_parameters
    base = np.array([q.kind != "effect" for q in parameters])
    effects = {q.effect for q in parameters if q.kind == "effect"}
    steps = (
        estimator.step(point, base | np.array([q.effect == effect for q in parameters]))
        for effect in effects
    )
    return max((fall for _, fall in steps), default=0.0)
