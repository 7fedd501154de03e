"""Verdict on a gap: whether the named effects explain it, and consistently."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from models.gap.estimation.normal_equation import mean_square
from models.gap.residuals.spectrum import Array
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.gap.search.strength_consistency import StrengthConsistency, strength_consistency_of
from models.plant.effects import EFFECTS

GapVerdict = Literal["no gap", "closed", "reduced", "not in the catalogue", "no floor"]


def consistencies_of_named(
    search: EffectSearch, result: SearchResult
) -> dict[str, StrengthConsistency]:
    """Strength consistency of each named effect; not of one with a dead zone.

    Parameters
    ----------
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run.
    """
    free = search.free(result.named)
    return {
        effect: strength_consistency_of(
            search.estimator, result.after, free, search.of[effect], EFFECTS[effect].port
        )
        for effect in result.named
        if effect not in result.unexcited
    }


def gap_verdict(
    search: EffectSearch,
    result: SearchResult,
    consistencies: Mapping[str, StrengthConsistency],
    held_out_left: float = 1.0,
) -> tuple[GapVerdict, float]:
    """Verdict, and the fraction of the gap's amplitude that is left.

    A named effect is a stand-in where its strength would have to differ from one payload, signal or
    band to the next, where most of the gap is left, or where the gap went into the variation
    between trials. A stand-in in a residual that the plant's own error reaches says nothing: the
    verdict is "no gap". In such a residual most may well be the plant's own error: what is left
    does not count there if every named effect stands out clearly, or if they lower the errors on
    what was left out far enough. In any residual it does not count if each stands out and the
    strengths of all of them also agree by χ²: no stand-in's did. Nor does it count where a named
    effect takes out of that variation what had gone into it. Without a learned noise floor nobody
    knows what noise is: then neither "no gap" nor "closed" nor "reduced" can be said, and the
    verdict is "no floor".

    Parameters
    ----------
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run.
    consistencies : mapping of str to StrengthConsistency
        Of the named effects.
    held_out_left : float
        Fraction of the held-out errors that the named effects leave.
    """
    settings = search.settings
    before, after = (
        _power_beyond_noise(search, point.rows) for point in (result.before, result.after)
    )
    left = float(np.sqrt(after / before)) if before > 0 else 0.0
    biased = bool(search.nuisance_bias(result.after))
    relieved = bool(search.nuisance_bias(result.before)) and not biased
    if not result.named:
        if biased or search.has_gap(result.before):
            return "not in the catalogue", 1.0
        return ("no gap", 0.0) if search.learned else ("no floor", 1.0)
    several = len(result.named) > 1 or any(r.kind == "inconsistent" for r in result.refused)
    fractions = settings.gap_left_limit_fraction, settings.gap_left_limit_fraction_of_several
    unclosed = left > fractions[several] and not relieved
    unclosed = unclosed and search.mean_residual(result.after) > settings.noise_residual
    unclosed = unclosed and not _is_certain(search, result, consistencies)
    differing = not all(c.holds for c in consistencies.values())
    gap = search.has_gap(result.before)
    if biased or (unclosed and gap) or (differing and (gap or not search.learned)):
        return "not in the catalogue", left
    unclosed = unclosed and not stands_out_clearly(search, result)
    unclosed = unclosed and held_out_left > settings.held_out_left_limit_fraction
    if search.learned and (differing or unclosed):
        return "no gap", left
    if not search.learned:
        return "no floor", left
    return ("reduced" if search.has_gap(result.after) else "closed"), left


def stands_out_clearly(search: EffectSearch, result: SearchResult) -> bool:
    """Whether every named effect exceeds what any effect showed in residuals without one.

    Parameters
    ----------
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run.
    """
    size = np.sqrt(max(search.mean_residual(result.after), 1.0))
    least = search.settings.clear_separation_fraction * size
    kept = [c for c in result.chosen if set(c.effects) & set(result.named)]
    return all(c.separation >= least * c.least for c in kept)


def _is_certain(
    search: EffectSearch, result: SearchResult, consistencies: Mapping[str, StrengthConsistency]
) -> bool:
    """Whether every named effect stands out clearly, with strengths that no χ² tells apart."""
    least = search.settings.inconsistency_probability
    known = [consistencies[e].probability for e in result.named if e in consistencies]
    agree = len(known) == len(result.named) and min(known, default=0.0) >= least
    return agree and stands_out_clearly(search, result)


def _power_beyond_noise(search: EffectSearch, rows: Sequence[Array]) -> float:
    """Mean square of a residual, in noise floors, beyond that of noise."""
    return max(mean_square(search.first.whitened(list(rows))) - 1.0, 0.0)
