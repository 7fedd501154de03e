"""Inclusions of an effect search, as a diagnosis tells them."""

from __future__ import annotations

from dataclasses import dataclass

from models.gap.decision.look_alikes import LookAlike, look_alikes_of
from models.gap.search.candidate import SearchResult


@dataclass(frozen=True)
class Inclusion:
    """One turn of the effect search that included something.

    Attributes
    ----------
    effects : tuple of str
        One effect, or a pair.
    kept : bool
        Whether they were still needed beside those included later.
    separation, least : float
        Their d′, and the least that they need.
    held_out_gain, held_out_error : float
        Fall of the cost on trials left out and of the nuisance's prior, in squared noise floors,
        and what it must exceed.
    look_alikes : tuple of LookAlike
        Effects that these trials cannot tell from them.
    """

    effects: tuple[str, ...]
    kept: bool
    separation: float
    least: float
    held_out_gain: float
    held_out_error: float
    look_alikes: tuple[LookAlike, ...]


def inclusions_of(result: SearchResult) -> tuple[Inclusion, ...]:
    """Inclusions of an effect search, in order.

    Parameters
    ----------
    result : SearchResult
        Of the whole search.
    """
    return tuple(
        Inclusion(
            effects=c.effects,
            kept=all(e in result.named for e in c.effects),
            separation=c.separation,
            least=c.least,
            held_out_gain=c.held_out_gain,
            held_out_error=c.held_out_error,
            look_alikes=look_alikes_of(result, turn),
        )
        for turn, c in enumerate(result.chosen)
    )
