"""Verdict on a gap, by the probabilities of what may be missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from models.gap.decision.answers import Answers
from models.gap.decision.further_effect import FurtherEffect
from models.gap.estimation.normal_equation import mean_square
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.gap.search.strength_consistency import StrengthConsistency
from models.plant.identification.noise_floor import Array

GapVerdict = Literal["no gap", "closed", "reduced", "not in the catalogue", "no floor"]


def gap_verdict(
    search: EffectSearch,
    result: SearchResult,
    consistencies: Mapping[str, StrengthConsistency],
    answers: Answers,
    further: FurtherEffect | None,
    believed: bool,
) -> GapVerdict:
    """Verdict on a tested search.

    If the named effects are accepted the verdict is "closed", or "reduced" where more remains than
    noise explains, or a further effect would explain more than noise and an error in the equations
    of those named. Otherwise it is the more probable one of "no gap" and "not in the catalogue".
    Without a learned noise floor the noise is unknown: the verdict is "no floor", or "not in the
    catalogue" where strengths differ or all trials deviate alike.
    """
    biased = bool(search.nuisance_bias(result.after))
    if not search.learned:
        differing = not all(c.holds for c in consistencies.values())
        unlike_noise = not result.named and search.has_gap(result.before)
        return "not in the catalogue" if biased or differing or unlike_noise else "no floor"
    if believed:
        more = further is not None and further.is_missing
        return "reduced" if biased or more or search.has_gap(result.after) else "closed"
    return "not in the catalogue" if answers.is_outside else "no gap"


def gap_left_fraction(search: EffectSearch, result: SearchResult) -> float:
    """Fraction of the gap's amplitude, in noise floors, that remains with the named effects."""
    before, after = (
        _power_beyond_noise(search, point.rows) for point in (result.before, result.after)
    )
    return float(np.sqrt(after / before)) if before > 0 else 0.0


def _power_beyond_noise(search: EffectSearch, rows: Sequence[Array]) -> float:
    """Mean square of a residual, in noise floors, beyond that of noise."""
    return max(mean_square(search.first.whitened(list(rows))) - 1.0, 0.0)
