"""Checks on the robot: how to see whether an effect is there.

A look at the robot often decides sooner than a further trial, and it tells look-alikes apart.
"""

from __future__ import annotations

from typing import Final

from models.gap.decision.certainty import DECIDED
from models.gap.report.gap_json import GapDocument, RefusedEffects
from models.shared.catalogue import EVERY_EFFECT, effect_and_joint

GENERAL_CHECK: Final = (
    "Change it on the robot on purpose, or take its cause away, and record a trial again."
)
"""Check of an effect that is not in the catalogue, such as one in a file of the user."""
MOST_CHECKS: Final = 5
"""Most effects that are listed."""


def standing_out(document: GapDocument) -> list[RefusedEffects]:
    """Effects that stand out and are not named, unless the named ones explain the gap."""
    if document.verdict == "closed":
        return []
    return [row for row in document.refused if row.kind != "not written"]


def effects_to_check(document: GapDocument) -> dict[str, str]:
    """Check of each effect that is named, may be missing, or looks like a named one.

    An effect that may be missing beside the named ones comes last.
    """
    named = [row.effect for row in document.named]
    likely = [e for e, p in document.effect_probabilities.items() if p > 1 - DECIDED]
    alike = [e for row in document.named for other in row.look_alikes for e in other.effects]
    refused = [e for row in standing_out(document) for e in row.effects]
    order = dict.fromkeys(effect_and_joint(e)[0] for e in (*named, *likely, *alike, *refused))
    return {
        e: EVERY_EFFECT[e].check if e in EVERY_EFFECT else GENERAL_CHECK
        for e in list(order)[:MOST_CHECKS]
    }
