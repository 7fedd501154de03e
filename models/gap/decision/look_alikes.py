"""Look-alikes: effects that these trials cannot tell apart.

They are what one round of the search could have included instead, by the posterior: the weights of
all candidates that were refitted in that round, which allow for an error in the named effect's own
equation (`models.gap.decision.set_weights`). A name and its look-alikes together hold 95 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from models.gap.decision.set_weights import set_weights
from models.gap.search.candidate import SearchResult
from models.plant.identification.noise_floor import Array

HELD_PROBABILITY: Final = 0.95
"""Probability that a set of hypotheses holds together: a name and its look-alikes, or the
hypotheses that remain after an experiment (requirement)."""


@dataclass(frozen=True)
class LookAlike:
    """Effects that explain the trials about as well as those included."""

    effects: tuple[str, ...]
    separation: float
    values: Array  # (p,), all fit parameters where they were fitted


def look_alikes_of(result: SearchResult, turn: int) -> tuple[LookAlike, ...]:
    """Candidates that might be missing instead of the one included in a round."""
    chosen = result.chosen[turn]
    others = [c for c in result.rounds[turn] if c.effects != chosen.effects]
    rows = sorted([chosen, *others], key=lambda c: c.score, reverse=True)
    size = np.array([len(c.effects) for c in rows])
    weights = set_weights(size, np.array([c.score for c in rows]), len(result.screened))
    before = np.cumsum(weights) - weights
    return tuple(
        LookAlike(c.effects, c.separation, c.point.values)
        for c, held in zip(rows, before / weights.sum(), strict=True)
        if c is not chosen and held < HELD_PROBABILITY
    )
