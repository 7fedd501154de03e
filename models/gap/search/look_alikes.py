"""Look-alikes: effects that these trials cannot tell apart.

Two effects are alike where refitting the other in place of the named one leaves the cost close to
it, an error in the named one's own equation allowed for.
"""

from __future__ import annotations

from dataclasses import dataclass

from models.gap.residuals.spectrum import Array
from models.gap.search.candidate import SearchResult
from models.gap.settings import DEFAULT_SETTINGS, GapSettings


@dataclass(frozen=True)
class LookAlike:
    """Effects that explain the trials about as well as those included.

    Attributes
    ----------
    effects : tuple of str
        Names.
    separation : float
        Their d′.
    values : ndarray, shape (p,)
        All fit parameters where they were fitted.
    """

    effects: tuple[str, ...]
    separation: float
    values: Array


def look_alikes_of(
    result: SearchResult, turn: int, settings: GapSettings = DEFAULT_SETTINGS
) -> tuple[LookAlike, ...]:
    """Candidates that did nearly as well as the one included in a turn.

    Where an equation misses a fraction ε of the gap, the gains of two effects that look alike
    differ by up to 2 ε sin(angle) of the whole either way; half of that is allowed for.

    Parameters
    ----------
    result : SearchResult
        Of the effect search.
    turn : int
        Number of the inclusion.
    settings : GapSettings
        Tuned numbers.
    """
    chosen = result.chosen[turn]
    margin = settings.indistinguishable_separation**2
    margin += settings.equation_error_fraction * chosen.separation**2
    return tuple(
        LookAlike(c.effects, c.separation, c.point.values)
        for c in result.rounds[turn]
        if c.effects != chosen.effects and chosen.score - c.score < margin
    )
