"""Further effect: the one that would explain most beside the named ones.

A stand-in leaves a part of the gap that another effect would absorb, and so does one of two missing
effects. The search has tried every effect beside those that it included. The gain of the best of
them is compared with the gain that noise and an error in the equations of the named effects reach.
Measured on diagnoses of rigs for tuning: 14 of 17 stand-ins for a denied effect left more, all 11
pairs of which one was named, and 41 of 139 correct names of the only missing effect.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import SearchResult, missed_by
from models.gap.search.effect_search import EffectSearch


class FurtherEffect(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Effect that would explain most beside the named ones, and the d′ that it must exceed."""

    effect: str
    separation: float  # d′ beside the named effects
    least: float  # d′ that noise and an error in the equations of the named effects reach

    @property
    def is_missing(self) -> bool:
        """Whether it explains more than noise and the error of an equation."""
        return self.separation > self.least


def further_effect_of(search: EffectSearch, result: SearchResult) -> FurtherEffect | None:
    """Best further effect; None if nothing is named, or none was tried beside the named ones."""
    named = frozenset(result.named)
    if not named:
        return None
    missed = missed_by([c for c in result.chosen if named & set(c.effects)], search.settings)
    found = []
    for effects, point in result.explored.items():
        if not named < effects or len(effects) > len(named) + 1:
            continue
        (effect,) = effects - named
        gain = max(2 * (result.after.cost - point.cost), 0.0)
        noise = max(search.mean_residual(point), 1.0) * search.least([effect], point) ** 2
        least = float(np.sqrt(noise + missed))
        found.append(FurtherEffect(effect, float(np.sqrt(gain)), least))
    return max(found, key=lambda f: f.separation / f.least, default=None)


def with_further_effect(
    search: EffectSearch, result: SearchResult, effect: str, point: FitPoint
) -> SearchResult:
    """Result that names one more effect."""
    more = replace(result, named=[*result.named, effect], after=point)
    if not any(effect in c.effects for c in result.chosen):
        found = search.candidate((effect,), point, result.after)
        more.chosen = [*result.chosen, found]
    more.explore(more.named, point)
    return more
