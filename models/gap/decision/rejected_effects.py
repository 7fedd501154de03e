"""Effects that were not named, each with its reason."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import msgspec
import numpy as np

from models.gap.decision.answers import Answers
from models.gap.search.candidate import SearchResult
from models.gap.search.null_distribution import NullDistribution
from models.gap.search.refused_effect import RefusedEffect, refusals

UNEXCITED: Final = "not excited by these trials"
SHOWN_SEPARATION: Final = 1.0
"""d′ above which an effect that does not show at small strengths shows at a large one: its standard
deviation by noise alone."""
IMPROBABLE: Final = "its probability is {:.0%} only; "
STAND_IN: Final = IMPROBABLE + "with {:.0%} it stands in for something else"
NOTHING_MISSING: Final = IMPROBABLE + "with {:.0%} nothing is missing"
STAND_IN_BESIDE_OTHERS: Final = (
    "beside the effects that are named it more probably stands in for something else"
)


class RejectedEffect(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Effect that was not named, with the reason."""

    effect: str
    separation: float  # d′ in the first round
    least: float  # Least d′ that it needs to be named
    reason: str


def rejected_effects(
    result: SearchResult, null_distribution: NullDistribution
) -> tuple[RejectedEffect, ...]:
    """Every effect of the catalogue that was not named, largest d′ first."""
    refused = {r.effect: f"refused: {r.reason}" for r in result.refused}
    refitted = {e: c for r in result.rounds for c in r for e in c.effects}
    rows = []
    for effect, size in sorted(result.screened.items(), key=lambda row: -row[1]):
        if effect in result.named:
            continue
        least = round(null_distribution.least([effect]), 3)
        if effect in refused:
            reason = refused[effect]
        elif effect in result.unexcited and size < SHOWN_SEPARATION:
            reason = UNEXCITED
        elif effect in refitted and not np.isnan(refitted[effect].held_out_gain):
            reason = "its gain does not hold on trials left out"
        elif result.named:
            reason = "explains less than what was named"
        elif size > least and refused:
            reason = "explains less than what was refused"
        else:
            reason = "explains no more than noise"
        rows.append(RejectedEffect(effect, round(size, 3), least, reason))
    known = {row.effect for row in rows} | set(result.named)
    rows += [
        RejectedEffect(e, 0.0, null_distribution.least([e]), UNEXCITED)
        for e in result.unexcited
        if e not in known
    ]
    return tuple(rows)


def refused_by_evidence(named: Iterable[str], answers: Answers) -> list[RefusedEffect]:
    """Refusals of effects that passed the tests but are not probable enough to be named."""
    if answers.is_outside:
        reason = STAND_IN.format(answers.catalogue, answers.outside)
        return refusals(named, "stand-in", reason, answers.outside)
    reason = NOTHING_MISSING.format(answers.catalogue, answers.nothing)
    return refusals(named, "improbable", reason, answers.nothing)
