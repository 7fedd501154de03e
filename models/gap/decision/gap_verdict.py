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
    what was left out far enough. In any residual neither what is left nor that variation counts if
    every named effect is certain (`certain_effects`); the verdict is then "reduced". Nor does what
    is left count where a named effect takes out of that variation what had gone into it. Without a
    learned noise floor nobody knows what noise is: then neither "no gap" nor "closed" nor "reduced"
    can be said, and the verdict is "no floor".

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
    certain = len(certain_effects(search, result, consistencies)) == len(result.named)
    several = len(result.named) > 1 or any(r.kind == "inconsistent" for r in result.refused)
    fractions = settings.gap_left_limit_fraction, settings.gap_left_limit_fraction_of_several
    unclosed = left > fractions[several] and not relieved
    unclosed = unclosed and search.mean_residual(result.after) > settings.noise_residual
    unclosed = unclosed and not certain
    differing = not all(c.holds for c in consistencies.values())
    gap = search.has_gap(result.before)
    hidden = biased and not certain
    if hidden or (unclosed and gap) or (differing and (gap or not search.learned)):
        return "not in the catalogue", left
    unclosed = unclosed and len(clear_effects(search, result)) < len(result.named)
    unclosed = unclosed and held_out_left > settings.held_out_left_limit_fraction
    if search.learned and (differing or unclosed):
        return "no gap", left
    if not search.learned:
        return "no floor", left
    return ("reduced" if biased or search.has_gap(result.after) else "closed"), left


def clear_effects(search: EffectSearch, result: SearchResult) -> list[str]:
    """Named effects that exceed what any effect showed in residuals without one.

    Parameters
    ----------
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run.
    """
    size = np.sqrt(max(search.mean_residual(result.after), 1.0))
    least = search.settings.clear_separation_fraction * size
    clear = {e for c in result.chosen if c.separation >= least * c.least for e in c.effects}
    return [e for e in result.named if e in clear]


def certain_effects(
    search: EffectSearch, result: SearchResult, consistencies: Mapping[str, StrengthConsistency]
) -> list[str]:
    """Named effects that stand out clearly, with strengths that no χ² tells apart.

    Parameters
    ----------
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run.
    consistencies : mapping of str to StrengthConsistency
        Of the named effects.
    """
    least = search.settings.inconsistency_probability
    agree = {e for e, c in consistencies.items() if c.probability >= least}
    return [e for e in clear_effects(search, result) if e in agree]


def _power_beyond_noise(search: EffectSearch, rows: Sequence[Array]) -> float:
    """Mean square of a residual, in noise floors, beyond that of noise."""
    return max(mean_square(search.first.whitened(list(rows))) - 1.0, 0.0)
