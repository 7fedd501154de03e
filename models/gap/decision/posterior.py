"""Posterior probabilities of what is missing, over the sets of effects that the search has fitted.

The evidence gives the probabilities that nothing is missing, that the named effects are, or that
something else is (`models.gap.decision.answers`). The second is shared by weight
(`models.gap.decision.set_weights`) among the named effects, their look-alikes, and sets that add
effects to those named; without a name among all sets. The probability of something else is not
among the hypotheses: they add up to the rest.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from models.gap.decision.answers import Answers
from models.gap.decision.look_alikes import look_alikes_of
from models.gap.decision.set_weights import set_weights
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.plant.identification.noise_floor import Array

LISTED_PROBABILITY: Final = 1e-3
"""Least probability of a hypothesis that is listed."""
DECIDED: Final = 0.9
"""Probability above which an effect counts as decided; below 1 − this, as excluded."""


@dataclass(frozen=True)
class Hypothesis:
    """Set of effects that may be missing, with its probability and fit."""

    effects: tuple[str, ...]  # Empty where nothing is missing
    probability: float
    squared_separation: float  # d′², the fall of twice the cost from the fit of the nuisance alone
    squared_least: float  # Value that `squared_separation` must reach
    values: Array  # (p,), all fit parameters where they were fitted
    free: Array  # (p,), fit parameters that were fitted


def posterior_of(
    search: EffectSearch, result: SearchResult, answers: Answers
) -> tuple[Hypothesis, ...]:
    """Hypotheses in order of their probability; something outside is not among them."""
    points = {
        tuple(sorted(effects)): point
        for effects, point in result.explored.items()
        if effects and _may_be_meant(effects, result)
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
    listed = [h for h in hypotheses if h.probability >= LISTED_PROBABILITY]
    return tuple(sorted(listed, key=lambda h: -h.probability))


def _may_be_meant(effects: frozenset[str], result: SearchResult) -> bool:
    """Whether a set holds the named effects, or as many of them and their look-alikes.

    Fewer do not count: the answer states that all named effects are missing.
    """
    named = set(result.named)
    if not named or effects >= named:
        return True
    turns = [k for k, c in enumerate(result.chosen) if named & set(c.effects)]
    alike = {e for k in turns for a in look_alikes_of(result, k) for e in a.effects}
    return len(effects) >= len(named) and effects <= named | alike


def effect_probabilities(hypotheses: Sequence[Hypothesis]) -> dict[str, float]:
    """Probability of each effect that it is among those missing, the most probable first."""
    found: dict[str, float] = defaultdict(float)
    for hypothesis in hypotheses:
        for effect in hypothesis.effects:
            found[effect] += hypothesis.probability
    return dict(sorted(found.items(), key=lambda row: -row[1]))
