"""Inclusions of an effect search, as reported by a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass

from models.gap.decision.look_alikes import LookAlike, look_alikes_of
from models.gap.search.candidate import SearchResult


@dataclass(frozen=True)
class Inclusion:
    """One round of the effect search that included an effect or a pair."""

    # One effect, or a pair; if one of a pair was taken out again, the other one
    effects: tuple[str, ...]
    kept: bool  # Whether the effects are named in the end
    separation: float  # Their d′
    least: float  # Least d′ that they need
    # Fall of the cost on held-out trials and of the nuisance's prior, in squared noise floors
    held_out_gain: float
    held_out_error: float  # Value that `held_out_gain` must exceed
    look_alikes: tuple[LookAlike, ...]  # Effects that these trials cannot tell from them


def inclusions_of(result: SearchResult) -> tuple[Inclusion, ...]:
    """Inclusions of an effect search, in order."""
    return tuple(_inclusion(result, turn) for turn in range(len(result.chosen)))


def _inclusion(result: SearchResult, turn: int) -> Inclusion:
    chosen = result.chosen[turn]
    left = tuple(e for e in chosen.effects if e in result.named)
    told = next((c for c in result.rounds[turn] if c.effects == left), chosen)
    return Inclusion(
        effects=left or chosen.effects,
        kept=bool(left),
        separation=told.separation,
        least=told.least,
        held_out_gain=chosen.held_out_gain,
        held_out_error=chosen.held_out_error,
        look_alikes=tuple(a for a in look_alikes_of(result, turn) if a.effects != left),
    )
