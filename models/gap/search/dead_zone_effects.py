"""Effects that show nothing where they are absent: a limit that is never met, play never crossed.

Derivatives there say nothing, so strengths are tried one by one: shares of the bound, and where the
effect itself reads a first strength from the trials (`Effect.dead_zone_strength`), that one
too. Then between the best and its neighbours.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.residuals.spectrum import Array
from models.gap.search.candidate import ALIKE
from models.plant.effects import EFFECTS

LADDER: Final = (0.3, 0.5, 0.65, 0.75, 0.8, 0.85, 0.9)
"""Shares of its bound at which an effect is tried that shows nothing where it is absent."""

REFINED: Final = 5
"""Times that the ladder is made denser around its best rung."""


def unexcited_effects(
    estimator: GaussNewton, point: FitPoint, base: Array, of: Mapping[str, Array]
) -> list[str]:
    """Effects whose whole range changes these trials by less than can be told apart.

    Parameters
    ----------
    estimator : GaussNewton
        Of the trials.
    point : FitPoint
        Where nothing is missing but the nuisance.
    base : ndarray of bool, shape (knobs,)
        Knobs of nuisance and trial variation.
    of : mapping of str to ndarray of bool
        Knobs of each effect.
    """
    result = []
    normal = estimator.linearise(point).normal
    index = np.flatnonzero(base)
    inner = normal[np.ix_(index, index)]
    knobs = estimator.problem.knobs
    for effect, own in of.items():
        k = int(np.flatnonzero(own)[0])
        across = normal[index, k]
        left = normal[k, k] - across @ np.linalg.solve(
            inner + 1e-12 * np.eye(len(index)) * np.trace(inner), across
        )
        reach = max(abs(knobs[k].low), abs(knobs[k].high))
        if np.sqrt(max(left, 0.0)) * reach < ALIKE:
            result.append(effect)
    return result


def strength_ladder(
    estimator: GaussNewton, here: FitPoint, effect: str, own: Array
) -> list[FitPoint]:
    """Points along the strength of an effect, denser around the best.

    Parameters
    ----------
    estimator : GaussNewton
        Of the trials.
    here : FitPoint
        Where the other knobs stand.
    effect : str
        Its name.
    own : ndarray of bool, shape (knobs,)
        Its knobs, the strength first.
    """
    problem, at = estimator.problem, int(np.flatnonzero(own)[0])
    knob = problem.knobs[at]
    rungs = [here]

    def climb(value: float) -> None:
        values = here.values.copy()
        values[at] = value
        rungs.append(estimator.at(values))

    known = {n: q.value for n, q in problem.plant.parameters.items()}
    met = EFFECTS[effect].dead_zone_strength(known, problem.trials)
    met -= known.get(next(iter(knob.parameters)), 0.0)
    for value in (*(share * knob.high for share in LADDER), met):
        climb(float(np.clip(value, 0.0, knob.high)))
    for _ in range(REFINED):
        rungs.sort(key=lambda p: p.values[at])
        best = min(range(len(rungs)), key=lambda k: rungs[k].cost)
        around = [p.values[at] for p in rungs[max(best - 1, 0) : best + 2]]
        for low, high in itertools.pairwise(around):
            climb((low + high) / 2)
    return [estimator.carry(here, p) for p in rungs if p is not here]
