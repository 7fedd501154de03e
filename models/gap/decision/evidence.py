"""Evidence of a tested search: it separates an explanation from a stand-in and from nothing.

Sizes enter as logarithms: the ratio of a residual or a d′ to its size where nothing is missing
counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np

from models.gap.decision.further_effect import FurtherEffect
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.gap.search.held_out_errors import HeldOutErrors
from models.gap.search.strength_consistency import StrengthConsistency, strength_consistency_of

LEAST_FRACTION: Final = 1e-2
"""Least fraction whose logarithm is taken: smaller ones prove no more."""


class Evidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Evidence of a search whose result was tested (`models.gap.decision.acceptance`)."""

    named: float  # 1 if an effect passed the tests, else 0
    # Logarithm of the mean squared residual with the nuisance refitted alone, over the largest that
    # counts as noise (`NullDistribution.explained`)
    gap: float
    # Logarithm of d′ over the least d′: of the named effect that exceeds it least, or of the best
    # candidate where nothing is named
    clearness: float
    # Largest standard deviation of a named effect's strength between payloads, signals and
    # frequencies, as a fraction of the strength
    difference: float
    # Logarithm of the largest ratio of a signal's held-out error to that of the diagnosed plant
    rise: float
    # Logarithm of the d′ of the best further effect over the least d′ that counts
    # (`models.gap.decision.further_effect`); 0 where nothing is named
    further: float
    # Logarithm of the largest fraction of a named effect's part of the gap that another effect
    # explains instead; 0 where nothing is named
    rival: float
    beyond_one: float = 0.0  # Number of effects beyond the first that passed the tests
    # Logarithm of the mean squared residual with the named effects, over the largest that counts as
    # noise; equals `gap` where nothing is named. None in records of older tests
    # (`models.gap.training`).
    left: float | None = None
    # Logarithm of the mean squared residual of the servos' currents with the nuisance refitted
    # alone, in noise floors. None in tests of names that do not need it.
    servo: float | None = None
    # Logarithm of the mean squared residual of the tip with the nuisance refitted alone, in noise
    # floors
    tip: float | None = None


def consistencies_of_named(
    search: EffectSearch, result: SearchResult
) -> dict[str, StrengthConsistency]:
    """Strength consistency of each named effect without a dead zone."""
    free = search.free(result.named)
    return {
        effect: strength_consistency_of(search.estimator, result.after, free, search.of[effect])
        for effect in result.named
        if effect not in result.unexcited
    }


def evidence_of(
    search: EffectSearch,
    result: SearchResult,
    consistencies: Mapping[str, StrengthConsistency],
    errors: HeldOutErrors,
    further: FurtherEffect | None,
) -> Evidence:
    ratios = errors.ratios(search.held_out.given)
    explained = search.null_distribution.explained
    return Evidence(
        named=float(bool(result.named)),
        beyond_one=float(max(len(result.named) - 1, 0)),
        gap=_logarithm(search.mean_residual(result.before) / explained),
        clearness=_logarithm(clearness_of(result)),
        difference=max((c.standard_deviation for c in consistencies.values()), default=0.0),
        rise=_logarithm(max(ratios.values(), default=1.0)),
        further=_logarithm(further.separation / further.least) if further else 0.0,
        rival=_logarithm(rival_fraction(result)) if result.named else 0.0,
        left=_logarithm(search.mean_residual(result.after) / explained),
        servo=_logarithm(signal_residual(search, result.before, "current_")),
        tip=_logarithm(signal_residual(search, result.before, "tip_")),
    )


def clearness_of(result: SearchResult) -> float:
    """d′ over the least d′; see `Evidence.clearness`."""
    if result.named:
        return min(clearness_by_effect(result)[e] for e in result.named)
    best = result.rounds[0] if result.rounds else []
    return max((c.separation / c.least for c in best), default=0.0)


def clearness_by_effect(result: SearchResult) -> dict[str, float]:
    """d′ over the least d′ of each included effect in its round; a pair counts together."""
    return {e: c.separation / c.least for c in result.chosen for e in c.effects}


def rival_fraction(result: SearchResult) -> float:
    """Fraction that another effect explains instead of a named one; see `Evidence.rival`.

    The part of a named effect is the rise of the cost without it. Its rival was fitted instead of
    it beside the rest.
    """
    named = frozenset(result.named)
    known: dict[frozenset[str], FitPoint] = {frozenset(): result.before, **result.explored}
    found = [0.0]
    for effects, point in result.explored.items():
        rest = effects & named
        if len(effects) == len(named) == len(rest) + 1 and rest in known:
            part = known[rest].cost - result.after.cost
            found.append((known[rest].cost - point.cost) / part if part > 0 else 0.0)
    return max(found)


def signal_residual(search: EffectSearch, point: FitPoint, prefix: str) -> float:
    """Mean squared residual of the signals with a prefix, in noise floors; 1 if none
    was measured.
    """
    found = [
        rows[:, [name.startswith(prefix) for name in group.signals]].ravel()
        for group, rows in zip(
            search.first.residuals.groups, search.first.whitened(point.rows), strict=True
        )
    ]
    values = np.concatenate(found)
    return float(np.mean(values**2)) if len(values) else 1.0


def _logarithm(fraction: float) -> float:
    return float(np.log(max(fraction, LEAST_FRACTION)))
