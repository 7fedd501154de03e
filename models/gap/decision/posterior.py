"""Posterior probabilities of what is missing, over the sets of effects that the search has fitted.

The evidence says how probable it is that nothing is missing, that effects of the catalogue are, or
that something else is (`models.gap.decision.answers`). What the catalogue holds is shared among the
sets: the weight of one is exp(score / 2T), its score the fall of twice the cost, less what its
effects reach where nothing is missing (`models.gap.search.null_distribution`). Sets that a test
refused, where others are named in their place, have no part. The temperature T keeps the errors of
the equations in: an equation that misses a fraction of the gap shifts the score of every set by a
fraction of the gap's own, so T grows with the best score.

Before the trials the number of missing effects is Poisson distributed with mean one, and every set
of one number is equally likely: in a large catalogue of N effects each effect of a set then counts
1/N. Without such a prior the many sets that add a useless effect to the right one outweigh it.

The two temperatures were fitted to 32 data sets of ten rigs of drawn structure (`drawn_24` to
`drawn_33`) by their logarithmic score; figures on rigs for testing stand in docs/gap.md.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from models.gap.decision.answers import Answers
from models.gap.residuals.spectrum import Array
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch

LEAST_TEMPERATURE: Final = 1.5
"""Temperature without a gap: a difference of d′ = 3 counts 20 to 1
(`GapSettings.indistinguishable_separation`)."""

TEMPERATURE_OF_GAP: Final = 1 / 15
"""Growth of the temperature with the square of d′. Of 1/60, 1/30, 1/20, 1/15, 1/10 and 1/7 those
from 1/15 on gave one Brier score; with less, an effect that corrects the first one's equation
counted as missing in 4 of 32 data sets."""

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


def posterior_of(
    search: EffectSearch,
    result: SearchResult,
    answers: Answers,
    refused: Sequence[Collection[str]] = (),
) -> tuple[Hypothesis, ...]:
    """Hypotheses in order of their probability; that of something outside is not among them.

    Parameters
    ----------
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run.
    answers : Answers
        Probabilities of the decision.
    refused : sequence of collection of str
        Sets of effects that a test refused where others were named in their place.
    """
    points = {
        tuple(sorted(effects)): point
        for effects, point in result.explored.items()
        if effects and not any(effects >= set(row) for row in refused)
    }
    hypotheses = []
    if search.learned or not points:
        before = result.before
        nothing = answers.nothing if points else 1.0 - answers.outside
        hypotheses = [Hypothesis((), nothing, 0.0, 0.0, before.values, search.free(()))]
    if points:
        cost = np.array([point.cost for point in points.values()])
        gain = 2 * ((result.before.cost if search.learned else float(cost.max())) - cost)
        least = np.array([search.least(e, point) ** 2 for e, point in points.items()])
        size = np.array([len(effects) for effects in points])
        weight = set_weights(size, gain - least, len(search.of))
        probability = answers.catalogue * weight / weight.sum()
        hypotheses += [
            Hypothesis(
                effects, float(probability[k]), float(gain[k]), float(least[k]), point.values,
                search.free(effects),
            )
            for k, (effects, point) in enumerate(points.items())
        ]  # fmt: skip
    listed = [h for h in hypotheses if h.probability >= LEAST_PROBABILITY]
    return tuple(sorted(listed, key=lambda h: -h.probability))


def set_weights(size: Array, score: Array, catalogue: int) -> Array:
    """Weight of each of some sets that are not empty, relative to the heaviest, shape (n,).

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
    return np.asarray(np.exp(logarithm - logarithm.max()))


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
