"""Strengths of an effect that no step from zero leads to.

An effect with a dead zone shows nothing below it, like a limit that is never met. Its derivatives
vanish there, so strengths are tried one by one: fractions of the bound and, where the effect itself
reads a first strength from the trials (`Effect.dead_zone_strength`), that one too; then values
between the best and its neighbours. Any other effect is tried at strengths far from zero too: a
plant that was identified without it may have compensated for it, as excessive damping for a
low-pass of the sensor. Then a far strength lowers the cost, although no step does. With a link only
the sign is tried to which derivatives lead.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import RIDGE, FitPoint, GaussNewton, Mask, NormalEquation
from models.plant.effects import EFFECTS

UNDETECTED_SEPARATION: Final = 3.0
"""d′ below which an effect at its bound cannot be detected (docs/sources.md, "Naming a missing
effect")."""
DISTANT_BOUND_FRACTIONS: Final = (0.1, 0.3)
"""Fractions of its bounds at which an effect is also tried: a lag of the current of 0.02 s and
0.06 s, or one of 0.05 s and 0.15 s on the flexible link, which needs 0.16 s (docs/sources.md, "Real
recordings"). For the inflatable link the first fraction is enough to tell whether a strength far
from zero lowers the cost."""
LADDER_BOUND_FRACTIONS: Final = (0.3, 0.5, 0.65, 0.75, 0.8, 0.85, 0.9)
"""Fractions of its bound at which an effect with a dead zone is tried [assumed]."""
LADDER_REFINEMENTS: Final = 5
"""Times that these strengths are refined around the best one [assumed]."""
FLAT_STEPS: Final = 2
"""Most steps of the fit from the best of these strengths [assumed]."""
FIT_STEPS: Final = 8
"""Most steps of the fit from a far strength of the plant as given [assumed]."""


def unexcited_candidates(
    estimator: GaussNewton, point: FitPoint, base: Mask, of: Mapping[str, Mask]
) -> list[str]:
    """Candidates whose whole range, to first order, changes these trials too little to be detected.

    Shapes: `base` (p,), each of `of` (p,).
    """
    result = []
    normal = estimator.linearise(point).normal
    index = np.flatnonzero(base)
    inner = NormalEquation.of(normal, index)
    for candidate, mask in of.items():
        k = int(np.flatnonzero(mask)[0])
        across = normal[index, k]
        information = normal[k, k] - across @ inner.solve(across, RIDGE)
        strength = estimator.residuals.fit_parameters[k]
        reach = max(abs(strength.low), abs(strength.high))
        if np.sqrt(max(information, 0.0)) * reach < UNDETECTED_SEPARATION:
            result.append(candidate)
    return result


def strengths_far_from_zero(
    estimator: GaussNewton,
    starts: Sequence[FitPoint],
    cost: float,
    effect: str,
    of_effect: Mask,
    free: Mask,
    is_flat: bool,
) -> list[FitPoint]:
    """Points at strengths of an effect that no step from zero leads to.

    `starts`: the fit so far, then the plant as given where it is a start too. `cost`: the least one
    known. `is_flat`: whether derivatives at zero show nothing of the effect; then a short fit
    follows from the best strength, since the nuisance may have compensated for the effect.

    Shapes: `of_effect` (p,), `free` (p,).
    """
    if is_flat:
        points = []
        for start in starts:
            rungs = strength_ladder(estimator, start, effect, of_effect)
            best = min(rungs, key=lambda p: p.cost)
            points += [*rungs, estimator.fit(best, free, FLAT_STEPS)]
        return points
    here, *unfitted = starts
    if estimator.residuals.plant.load != "link":
        return _distant_strengths(estimator, here, of_effect, DISTANT_BOUND_FRACTIONS)
    points = _distant_strengths(estimator, here, of_effect, DISTANT_BOUND_FRACTIONS[:1], free)
    cost = min([cost, *(point.cost for point in points)])
    for start in unfitted:
        points += _promising_strength(estimator, start, of_effect, free, cost)
    return points


def _promising_strength(
    estimator: GaussNewton, unfitted: FitPoint, of_effect: Mask, free: Mask, cost: float
) -> list[FitPoint]:
    """Fit from the plant as given and a far strength, where derivatives predict a lower cost.

    The nuisance fit may have compensated for an effect by a changed link, and no step leads back: a
    dead time of 39 ms ended as 4 ms beside another link. The plant as given has the right link.
    """
    rows = []
    for point in _distant_strengths(estimator, unfitted, of_effect, DISTANT_BOUND_FRACTIONS, free):
        _, fall = estimator.step(point, free)
        rows.append((point.cost - fall, point))
    promised, best = min(rows, key=lambda row: row[0], default=(cost, unfitted))
    return [estimator.fit(best, free, FIT_STEPS)] if promised < cost else []


def _distant_strengths(
    estimator: GaussNewton,
    here: FitPoint,
    of_effect: Mask,
    fractions: Sequence[float],
    free: Mask | None = None,
) -> list[FitPoint]:
    """Points at some fractions of an effect's bounds.

    With `free` only of the bound to which a step of these fit parameters leads.
    """
    at = int(np.flatnonzero(of_effect)[0])
    strength = estimator.residuals.fit_parameters[at]
    bounds = {strength.low, strength.high}
    if free is not None:
        step, _ = estimator.step(here, free)
        bounds = {strength.high if step[at] > 0 else strength.low}
    result = []
    for fraction in fractions:
        for bound in bounds - {0.0}:
            values = here.values.copy()
            values[at] = fraction * bound
            point = estimator.at(values)
            if point.cost < np.inf:
                result.append(estimator.carry(here, point))
    return result


def strength_ladder(
    estimator: GaussNewton, here: FitPoint, effect: str, of_effect: Mask
) -> list[FitPoint]:
    """Points along the strength of an effect, denser around the best.

    Shapes: `of_effect` (p,).
    """
    residuals = estimator.residuals
    at = int(np.flatnonzero(of_effect)[0])
    strength = residuals.fit_parameters[at]
    rungs = [here]

    def climb(value: float) -> None:
        values = here.values.copy()
        values[at] = value
        rungs.append(estimator.at(values))

    known = {n: q.value for n, q in residuals.plant.parameters.items()}
    met = EFFECTS[effect].dead_zone_strength(known, residuals.trials)
    met -= known.get(next(iter(strength.parameters)), 0.0)
    first = [fraction * strength.high for fraction in LADDER_BOUND_FRACTIONS]
    for value in (*first, met):
        climb(float(np.clip(value, 0.0, strength.high)))
    for _ in range(LADDER_REFINEMENTS):
        rungs.sort(key=lambda p: p.values[at])
        best = min(range(len(rungs)), key=lambda k: rungs[k].cost)
        around = [p.values[at] for p in rungs[max(best - 1, 0) : best + 2]]
        for low, high in itertools.pairwise(around):
            climb((low + high) / 2)
    return [estimator.carry(here, p) for p in rungs if p is not here]
