"""Posterior probabilities of what is missing, over the sets of effects that the search has fitted.

The weight of a set is exp(score / 2T): the score is the fall of twice the cost, less what its
effects reach where nothing is missing (`models.gap.search.null_distribution`). The temperature T
keeps the errors of the equations in: an equation that misses a fraction of the gap shifts the score
of every set by a fraction of the gap's own, so T grows with the best score.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from models.gap.residuals.spectrum import Array
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch

LEAST_TEMPERATURE: Final = 1.5
"""Temperature without a gap: a difference of d′ = 3 counts 20 to 1
(`GapSettings.indistinguishable_separation`)."""

TEMPERATURE_OF_GAP: Final = 1 / 60
"""Growth of the temperature with the square of d′: an equation's error of 5 % of the gap counts
20 to 1 (`GapSettings.equation_error_fraction`)."""

LEAST_PROBABILITY: Final = 1e-3
"""Hypotheses below this are not listed."""


@dataclass(frozen=True)
class Hypothesis:
    """One answer to the question of what is missing.

    Attributes
    ----------
    effects : tuple of str
        None where nothing is missing.
    probability : float
        Posterior.
    values : ndarray, shape (p,)
        All fit parameters where they were fitted.
    free : ndarray of bool, shape (p,)
        Fit parameters that were fitted.
    """

    effects: tuple[str, ...]
    probability: float
    values: Array
    free: Array


def posterior_of(search: EffectSearch, result: SearchResult) -> tuple[Hypothesis, ...]:
    """Hypotheses in order of their probability.

    Parameters
    ----------
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run.
    """
    fits = dict(result.explored)
    if search.learned or not fits:
        fits[frozenset()] = result.before
    worst = max(point.cost for point in fits.values())
    null = search.null_distribution
    score = np.array(
        [2 * (worst - p.cost) - (null.least(sorted(e)) ** 2 if e else 0) for e, p in fits.items()]
    )
    nothing = 2 * (worst - fits[frozenset()].cost) if frozenset() in fits else score.min()
    temperature = LEAST_TEMPERATURE + TEMPERATURE_OF_GAP * max(float(score.max()) - nothing, 0.0)
    weight = np.exp((score - score.max()) / (2 * temperature))
    probability = weight / weight.sum()
    order = np.argsort(-probability, kind="stable")
    sets = list(fits)
    return tuple(
        Hypothesis(
            tuple(sorted(sets[k])), float(probability[k]), fits[sets[k]].values,
            search.free(sorted(sets[k])),
        )
        for k in order
        if probability[k] >= LEAST_PROBABILITY
    )  # fmt: skip
