"""Posterior probabilities of what is missing, over the sets of effects that the search has fitted.

The weight of a set is exp(score / 2T): the score is the fall of twice the cost, less what its
effects reach where nothing is missing (`models.gap.search.null_distribution`). The temperature T
keeps the errors of the equations in: an equation that misses a fraction of the gap shifts the score
of every set by a fraction of the gap's own, so T grows with the best score.

Before the trials the number of missing effects is Poisson distributed with mean one, and every set
of one number is equally likely: in a large catalogue of N effects each effect of a set then counts
1/N. Without such a prior the many sets that add a useless effect to the right one outweigh it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
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
    gain, least : float
        Fall of twice the cost from the fit of the nuisance alone, and what it must reach.
    values : ndarray, shape (p,)
        All fit parameters where they were fitted.
    free : ndarray of bool, shape (p,)
        Fit parameters that were fitted.
    """

    effects: tuple[str, ...]
    probability: float
    gain: float
    least: float
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
    sets = [tuple(sorted(effects)) for effects in fits]
    cost = np.array([point.cost for point in fits.values()])
    nothing = fits[frozenset()].cost if frozenset() in fits else float(cost.max())
    gain = 2 * (nothing - cost)
    null = search.null_distribution
    least = np.array([null.least(effects) ** 2 if effects else 0.0 for effects in sets])
    size = np.array([len(effects) for effects in sets])
    probability = set_probabilities(size, gain - least, len(search.of))
    return tuple(
        Hypothesis(
            sets[k], float(probability[k]), float(gain[k]), float(least[k]),
            fits[frozenset(sets[k])].values, search.free(sets[k]),
        )
        for k in np.argsort(-probability, kind="stable")
        if probability[k] >= LEAST_PROBABILITY
    )  # fmt: skip


def set_probabilities(size: Array, score: Array, catalogue: int) -> Array:
    """Probability of each of some sets of effects, shape (n,); see the module's text.

    Parameters
    ----------
    size : ndarray of int, shape (n,)
        Effects in each set.
    score : ndarray, shape (n,)
        Fall of twice the cost, less what it must reach.
    catalogue : int
        Effects that could be missing.
    """
    temperature = LEAST_TEMPERATURE + TEMPERATURE_OF_GAP * max(float(score.max()), 0.0)
    logarithm = score / (2 * temperature) - size * np.log(max(catalogue, 1))
    weight: Array = np.exp(logarithm - logarithm.max())
    return weight / float(weight.sum())


def effect_probabilities(hypotheses: Sequence[Hypothesis]) -> dict[str, float]:
    """Probability of each effect that it is among those missing, likeliest first.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        From `posterior_of`.
    """
    found: dict[str, float] = defaultdict(float)
    for hypothesis in hypotheses:
        for effect in hypothesis.effects:
            found[effect] += hypothesis.probability
    return dict(sorted(found.items(), key=lambda row: -row[1]))
