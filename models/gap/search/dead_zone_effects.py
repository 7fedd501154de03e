"""Strengths of an effect that no step from zero leads to.

An effect with a dead zone shows nothing below it, like a limit that is never met. Its derivatives
vanish there, so strengths are tried one by one: fractions of the bound and, where the effect itself
reads a first strength from the trials (`Effect.dead_zone_strength`), that one too; then values
between the best and its neighbours. Strengths far from zero are tried for any other effect too,
from the present fit and from the plant that is diagnosed.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.normal_equation import NormalEquation
from models.plant.effects import EFFECTS
from models.plant.identification.noise_floor import Array


def unexcited_effects(
    estimator: GaussNewton, point: FitPoint, base: Array, of: Mapping[str, Array]
) -> list[str]:
    """Effects whose whole range changes these trials too little to be detected.

    Shapes: `base` (p,).
    """
    result = []
    normal = estimator.linearise(point).normal
    index = np.flatnonzero(base)
    inner, ridge = NormalEquation.of(normal, index), estimator.settings.normal_ridge_fraction
    for effect, own in of.items():
        k = int(np.flatnonzero(own)[0])
        across = normal[index, k]
        left = normal[k, k] - across @ inner.solve(across, ridge)
        strength = estimator.residuals.fit_parameters[k]
        reach = max(abs(strength.low), abs(strength.high))
        if np.sqrt(max(left, 0.0)) * reach < estimator.settings.indistinguishable_separation:
            result.append(effect)
    return result


def strengths_far_from_zero(
    estimator: GaussNewton,
    here: FitPoint,
    others: Sequence[FitPoint],
    cost: float,
    effect: str,
    own: Array,
    free: Array,
    flat: bool,
) -> list[FitPoint]:
    """Points at strengths of an effect that no step from zero leads to.

    A plant that was identified without an effect may have compensated for it: excessive damping
    looks like a low-pass of the sensor. Then a far strength lowers the cost, although no step does.
    Nor does a step lead to a low-pass of a current with a saw-tooth, which vanishes at any
    strength. An effect with a dead zone gets a ladder of strengths, and a short fit from its best
    rung, since the nuisance may have compensated for the effect.

    Shapes: `own` (p,), `free` (p,).

    `others`: further starts with derivatives, such as the plant that is diagnosed.
    """
    if flat:
        steps, found = estimator.settings.candidate_start_steps, []
        for start in [here, *others]:
            rungs = strength_ladder(estimator, start, effect, own)
            best = min(rungs, key=lambda p: p.cost)
            found += [*rungs, estimator.fit(best, free, steps)]
        return found
    fractions = estimator.settings.distant_bound_fractions
    if estimator.residuals.plant.load != "link":
        return _distant_strengths(estimator, here, own, fractions)
    found = _distant_strengths(estimator, here, own, fractions[:1])
    cost = min([cost, *(point.cost for point in found)])
    for start in others:
        found += _promising_strength(estimator, start, own, free, cost)
    return found


def _promising_strength(
    estimator: GaussNewton, given: FitPoint, own: Array, free: Array, cost: float
) -> list[FitPoint]:
    """Fit from the diagnosed plant and a far strength, where derivatives predict a lower cost.

    The nuisance fit may have compensated for an effect by a changed link, and no step leads back: a
    dead time of 39 ms ended as 4 ms beside another link. The diagnosed plant has the right link.
    """
    rows, fractions = [], estimator.settings.distant_bound_fractions
    for point in _distant_strengths(estimator, given, own, fractions):
        _, fall = estimator.step(point, free)
        rows.append((point.cost - fall, point))
    promised, best = min(rows, key=lambda row: row[0], default=(cost, given))
    if promised >= cost:
        return []
    return [estimator.fit(best, free, estimator.settings.candidate_fit_steps)]


def _distant_strengths(
    estimator: GaussNewton, here: FitPoint, own: Array, fractions: Sequence[float]
) -> list[FitPoint]:
    """Points at some fractions of an effect's bounds."""
    at = int(np.flatnonzero(own)[0])
    strength = estimator.residuals.fit_parameters[at]
    result = []
    for fraction in fractions:
        for bound in {strength.low, strength.high} - {0.0}:
            values = here.values.copy()
            values[at] = fraction * bound
            point = estimator.at(values)
            if point.cost < np.inf:
                result.append(estimator.carry(here, point))
    return result


def strength_ladder(
    estimator: GaussNewton, here: FitPoint, effect: str, own: Array
) -> list[FitPoint]:
    """Points along the strength of an effect, denser around the best.

    Shapes: `own` (p,).
    """
    residuals, settings = estimator.residuals, estimator.settings
    at = int(np.flatnonzero(own)[0])
    strength = residuals.fit_parameters[at]
    rungs = [here]

    def climb(value: float) -> None:
        values = here.values.copy()
        values[at] = value
        rungs.append(estimator.at(values))

    known = {n: q.value for n, q in residuals.plant.parameters.items()}
    met = EFFECTS[effect].dead_zone_strength(known, residuals.trials)
    met -= known.get(next(iter(strength.parameters)), 0.0)
    first = [fraction * strength.high for fraction in settings.ladder_bound_fractions]
    for value in (*first, met):
        climb(float(np.clip(value, 0.0, strength.high)))
    for _ in range(settings.ladder_refinements):
        rungs.sort(key=lambda p: p.values[at])
        best = min(range(len(rungs)), key=lambda k: rungs[k].cost)
        around = [p.values[at] for p in rungs[max(best - 1, 0) : best + 2]]
        for low, high in itertools.pairwise(around):
            climb((low + high) / 2)
    return [estimator.carry(here, p) for p in rungs if p is not here]
