"""Look-alikes of a name, and hypotheses: sets of effects that explain the trials about as well.

A set whose squared d′ is Δ less than the best one, S, weighs exp(−min(Δ / 2T, a √(Δ / S))). The
first term is that of noise. The second accounts for equation errors: an equation that misses a
fraction ε of the gap changes the difference of two squares by up to 2 ε √(S Δ), so Δ exceeds this
by √(Δ / S) / 2ε times. A priori the number of missing effects is Poisson distributed with a mean m,
and all sets of one size are equally probable, so each effect of a set counts m / N in a catalogue
of N. Without that the many sets that add a useless effect to the right one would outweigh it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from models.gap.decision.certainty import Answers
from models.gap.decision.naming import Naming
from models.gap.search.effect_search import SetFit
from models.plant.step_model import Array

NOISE_TEMPERATURE: Final = 1.5
"""T: a difference of d′ = 3, below which two effects cannot be told apart (docs/sources.md, "Naming
a missing effect"), counts 20 to 1."""
ODDS_OF_WHOLE_GAP: Final = 12.0
"""a: logarithm of the odds between the best set and one that explains nothing. Of values tried on
diagnoses of rigs for tuning it is the least certain one whose loss is within a standard error of
the least."""
MEAN_NUMBER: Final = 0.05
"""m: mean number of missing effects; chosen as `ODDS_OF_WHOLE_GAP`."""
HELD_PROBABILITY: Final = 0.95
"""Probability that a name and its look-alikes hold together (requirement)."""
LISTED_PROBABILITY: Final = 1e-3
"""Least probability of a hypothesis that is listed."""


@dataclass(frozen=True)
class Hypothesis:
    """Set of effects that may be missing; empty where nothing is."""

    effects: tuple[str, ...]
    probability: float
    fit: SetFit


def look_alikes_of(naming: Naming) -> dict[str, tuple[SetFit, ...]]:
    """Candidates that may be missing instead of each named effect, the likeliest first.

    They were tried beside the same others, and hold 95 % together with it.
    """
    look_alikes: dict[str, tuple[SetFit, ...]] = {}
    for name in naming.names:
        rest = set(naming.names) - {name}
        rows = [f for f in naming.explored if rest < set(f.candidates)]
        rows = [f for f in rows if len(f.candidates) == len(naming.names)]
        weights = set_weights(rows, len(naming.search.of))
        before = np.cumsum(weights) - weights
        look_alikes[name] = tuple(
            f for f, before_it in zip(rows, before / max(weights.sum(), 1e-300), strict=True)
            if name not in f.candidates and before_it < HELD_PROBABILITY
        )  # fmt: skip
    return look_alikes


def hypotheses_of(naming: Naming) -> tuple[Hypothesis, ...]:
    """Sets of effects that may be missing, the most probable first; nothing is one of them.

    The probability that the named effects are what is missing is shared by weight among them, their
    look-alikes, and sets that add effects to those named. That something outside of the catalogue
    is missing is no hypothesis: they add up to the rest.
    """
    names, answers = set(naming.names), naming.answers
    rows = [f for f in naming.explored if len(f.candidates) >= len(names)]
    if not answers or not rows:
        rows = rows or [naming.search.nothing]
        answers = Answers(0.0, 1.0, 0.0)
        hypotheses = []
    else:
        hypotheses = [Hypothesis((), answers.nothing, naming.search.nothing)]
    weights = set_weights(rows, len(naming.search.of))
    share = answers.catalogue * weights / weights.sum()
    hypotheses += [Hypothesis(f.candidates, float(p), f) for f, p in zip(rows, share, strict=True)]
    listed = [h for h in hypotheses if h.probability >= LISTED_PROBABILITY]
    return tuple(sorted(listed, key=lambda h: -h.probability))


def effect_probabilities(hypotheses: Sequence[Hypothesis]) -> dict[str, float]:
    """Probability of each effect that it is among those missing, the most probable first."""
    total: dict[str, float] = defaultdict(float)
    for hypothesis in hypotheses:
        for effect in hypothesis.effects:
            total[effect] += hypothesis.probability
    return dict(sorted(total.items(), key=lambda row: -row[1]))


def set_weights(sets: Sequence[SetFit], catalogue: int) -> Array:
    """Weight of each of some sets, relative to the heaviest, shape (sets,)."""
    if not sets:
        return np.zeros(0)
    square = np.array([2 * f.gain for f in sets])
    less = square.max() - square
    by_noise = less / (2 * NOISE_TEMPERATURE)
    by_equation = ODDS_OF_WHOLE_GAP * np.sqrt(less / max(square.max(), 1.0))
    size = np.array([len(f.candidates) for f in sets])
    logarithm = size * np.log(MEAN_NUMBER / max(catalogue, 1)) - np.minimum(by_noise, by_equation)
    return np.asarray(np.exp(logarithm - logarithm.max()))
