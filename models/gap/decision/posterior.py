"""Posterior probabilities of what is missing, over the sets of effects that the search has fitted.

Whether anything is missing is judged by the best set alone: by the logarithm of its d′ over the d′
that it must reach (`models.gap.search.null_distribution`). Among the sets the weight of one is
exp(score / 2T): the score is the fall of twice the cost, less what its effects reach where nothing
is missing. The temperature T keeps the errors of the equations in: an equation that misses a
fraction of the gap shifts the score of every set by a fraction of the gap's own, so T grows with
the best score.

Before the trials the number of missing effects is Poisson distributed with mean one, and every set
of one number is equally likely: in a large catalogue of N effects each effect of a set then counts
1/N. Without such a prior the many sets that add a useless effect to the right one outweigh it.

The three numbers of this module were fitted to 32 data sets of ten rigs of drawn structure
(`drawn_24` to `drawn_33`) by their logarithmic score; figures on rigs for testing stand in
docs/gap.md.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import norm

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

EVEN_LOG_RATIO: Final = 0.35
"""Logarithm of d′ over the least d′ of the best set at which "nothing" is as probable as
"something"."""

LOG_RATIO_DEVIATION: Final = 0.25
"""Standard deviation of that logarithm where nothing is missing: the plant's own error differs from
rig to rig."""

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
    least = np.array(
        [
            search.least(effects, point) ** 2 if effects else 0.0
            for effects, point in zip(sets, fits.values(), strict=True)
        ]
    )
    size = np.array([len(effects) for effects in sets])
    probability = set_probabilities(size, gain, least, len(search.of))
    return tuple(
        Hypothesis(
            sets[k], float(probability[k]), float(gain[k]), float(least[k]),
            fits[frozenset(sets[k])].values, search.free(sets[k]),
        )
        for k in np.argsort(-probability, kind="stable")
        if probability[k] >= LEAST_PROBABILITY
    )  # fmt: skip


def set_probabilities(size: Array, gain: Array, least: Array, catalogue: int) -> Array:
    """Probability of each of some sets of effects, shape (n,); see the module's text.

    Parameters
    ----------
    size : ndarray of int, shape (n,)
        Effects in each set; 0 for "nothing is missing", which need not be among them.
    gain, least : ndarray, shape (n,)
        Fall of twice the cost, and what it must reach.
    catalogue : int
        Effects that could be missing.
    """
    sets = size > 0
    probability = np.where(sets, 0.0, 1.0)
    if not sets.any():
        return probability
    weight = set_weights(size[sets], (gain - least)[sets], catalogue)
    ratio = np.maximum(gain, 1e-12)[sets] / least[sets]
    log_ratio = float(np.log(ratio).max()) / 2
    something = float(norm.cdf((log_ratio - EVEN_LOG_RATIO) / LOG_RATIO_DEVIATION))
    something = something if not sets.all() else 1.0
    probability[sets] = something * weight / weight.sum()
    probability[~sets] *= 1 - something
    return probability


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
