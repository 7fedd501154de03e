"""Evidence of a tested search: what tells an explanation from a stand-in and from nothing.

Sizes enter by their logarithms: what counts is by how much a residual or a d′ exceeds what it
reaches where nothing is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np

from models.gap.estimation.nuisance_bias import nuisance_biases
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.gap.search.held_out_errors import HeldOutErrors
from models.gap.search.strength_consistency import StrengthConsistency

LEAST_FRACTION: Final = 1e-2
"""Least fraction whose logarithm is taken: what is smaller proves no more."""

LEAST_PROBABILITY: Final = 1e-12
"""Least probability of differing strengths, likewise."""


class Evidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Evidence of a search whose result was tested (`models.gap.decision.acceptance`).

    Attributes
    ----------
    named : float
        1 where the tests leave an effect, else 0.
    gap, left : float
        Logarithm of the mean squared residual over the largest that counts as noise
        (`NullDistribution.explained`): with the nuisance refitted alone, and with what is named.
    clearness : float
        Logarithm of d′ over the least d′: of the named effect that exceeds it least, or of the best
        candidate where nothing is named.
    difference : float
        Largest standard deviation of a named effect's strength between payloads, signals and
        frequencies, as a fraction of the strength.
    contradiction : float
        Largest −log10 of the probability that χ² gives to these differences.
    rise : float
        Logarithm of the largest ratio of a signal's held-out error to that of the plant as given.
    bias : float
        Logarithm of 1 + |z| of the largest variation that all trials share
        (`models.gap.estimation.nuisance_bias`), with what is named.
    """

    named: float
    gap: float
    left: float
    clearness: float
    difference: float
    contradiction: float
    rise: float
    bias: float


FEATURES: Final = Evidence.__struct_fields__
"""Names of the numbers, in order."""


def evidence_of(
    search: EffectSearch,
    result: SearchResult,
    consistencies: Mapping[str, StrengthConsistency],
    errors: HeldOutErrors,
) -> Evidence:
    """Evidence of a tested search.

    Parameters
    ----------
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run; `named` holds what the tests left.
    consistencies : mapping of str to StrengthConsistency
        Of the named effects.
    errors : HeldOutErrors
        Of the fit with the named effects.
    """
    biases = nuisance_biases(search.fit_parameters, result.after, search.settings)
    probability = min((c.probability for c in consistencies.values()), default=1.0)
    ratios = errors.ratios(search.held_out.given)
    explained = search.null_distribution.explained
    return Evidence(
        named=float(bool(result.named)),
        gap=_logarithm(search.mean_residual(result.before) / explained),
        left=_logarithm(search.mean_residual(result.after) / explained),
        clearness=_logarithm(clearness_of(result)),
        difference=max((c.standard_deviation for c in consistencies.values()), default=0.0),
        contradiction=-float(np.log10(max(probability, LEAST_PROBABILITY))),
        rise=_logarithm(max(ratios.values(), default=1.0)),
        bias=float(np.log1p(max((abs(z) for z in biases.values()), default=0.0))),
    )


def clearness_of(result: SearchResult) -> float:
    """d′ over the least d′; see `Evidence.clearness`.

    Parameters
    ----------
    result : SearchResult
        Of the effect search.
    """
    if result.named:
        return min(clearness_by_effect(result)[e] for e in result.named)
    best = result.rounds[0] if result.rounds else []
    return max((c.separation / c.least for c in best), default=0.0)


def clearness_by_effect(result: SearchResult) -> dict[str, float]:
    """d′ over the least d′ of each effect that was included, in its turn; of a pair together.

    Parameters
    ----------
    result : SearchResult
        Of the effect search.
    """
    return {e: c.separation / c.least for c in result.chosen for e in c.effects}


def _logarithm(fraction: float) -> float:
    return float(np.log(max(fraction, LEAST_FRACTION)))
