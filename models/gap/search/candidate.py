"""Candidates of the effect search, and its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.refused_effect import RefusedEffect
from models.gap.settings import GapSettings
from models.plant.effects import EFFECTS


@dataclass
class Candidate:
    """Candidate of the search (one effect, or two) and its fit."""

    effects: tuple[str, ...]
    point: FitPoint
    gain: float  # Fall of the cost
    least: float  # Least d′ that the effects must reach
    # The same on a link that did not change since the plant was identified
    least_on_same_link: float
    predicted: float = 0.0  # Fall of the cost that derivatives predict
    # Fall of the cost on held-out trials and of the nuisance's prior; NaN before cross-validation
    held_out_gain: float = np.nan
    # Value that `held_out_gain` must exceed; NaN before cross-validation
    held_out_error: float = np.nan
    # Its fit parameters that ended at a bound and keep the plant's value
    held: frozenset[int] = frozenset()

    @property
    def score(self) -> float:
        """Twice the gain, less the square of the least d′."""
        return 2 * self.gain - self.least**2

    @property
    def hope(self) -> float:
        """Score that a screened candidate may reach if the gain that derivatives predict comes
        true.

        It assumes an unchanged link, since the refit may undo the change of the link.
        """
        score = 2 * self.gain - self.least_on_same_link**2
        return score + max(self.predicted - self.gain, 0.0)

    @property
    def separation(self) -> float:
        """Its d′: the square root of twice the fall of the cost."""
        return float(np.sqrt(max(2 * self.gain, 0.0)))

    def missed_fraction(self, settings: GapSettings) -> float:
        """Fraction of d′ that the equations of the effects may miss."""
        by_port = settings.further_effect_fraction_by_port
        general = settings.further_effect_fraction
        return max(by_port.get(EFFECTS[e].port, general) for e in self.effects)


@dataclass
class SearchResult:
    before: FitPoint  # Fit of nuisance and trial variation alone
    after: FitPoint  # Fit with the named effects
    # In order of inclusion, without those deleted again
    named: list[str] = field(default_factory=list)
    # Refitted candidates of each round, best first
    rounds: list[list[Candidate]] = field(default_factory=list)
    # d′ of every effect in the first round's screen
    screened: dict[str, float] = field(default_factory=dict)
    # Effects that these trials could not show at any strength within bounds
    unexcited: list[str] = field(default_factory=list)
    chosen: list[Candidate] = field(default_factory=list)  # Included candidate of each round
    # Candidates whose strength ended at a bound, and effects that the acceptance takes out
    refused: list[RefusedEffect] = field(default_factory=list)
    # Best fit of each set of effects that was tried, against the same floor
    explored: dict[frozenset[str], FitPoint] = field(default_factory=dict)

    def explore(self, effects: Sequence[str], point: FitPoint) -> None:
        """Store the fit of a set of effects if it is the best so far."""
        key = frozenset(effects)
        if key not in self.explored or point.cost < self.explored[key].cost:
            self.explored[key] = point


def beyond_limits(
    candidate: Candidate, found: SearchResult, left: float, settings: GapSettings
) -> tuple[float, float, float]:
    """Margins by which a candidate exceeds its limits, in squared d′; it passes those above zero.

    The limit grows with the residual that a candidate leaves, as in an F-test, and with the
    equation error of the effects that were included before: at most 10 to 20 % of their d′ for a
    candidate whose strength is the same everywhere, 35 % for any other.

    Returns the margin over its least d′; the margin that also allows for the equation error of
    earlier effects; and the same if its strength is not consistent.
    """
    beyond = 2 * candidate.gain - max(left, 1.0) * candidate.least**2
    missed = missed_by(found.chosen, settings)
    linear = [c for c in found.chosen if not set(c.effects) & set(found.unexcited)]
    doubt = settings.inconsistent_further_effect_fraction
    doubted = max(missed, sum((doubt * c.separation) ** 2 for c in linear))
    return beyond, beyond - missed, beyond - doubted


def may_pass(candidate: Candidate, found: SearchResult, settings: GapSettings) -> bool:
    """Whether a further candidate may pass its limits after its refit."""
    reach = settings.refit_growth * 2 * max(candidate.gain, candidate.predicted)
    return reach > candidate.least_on_same_link**2 + missed_by(found.chosen, settings)


def missed_by(chosen: Sequence[Candidate], settings: GapSettings) -> float:
    """Squared d′ that the equations of included effects may miss."""
    return sum((c.missed_fraction(settings) * c.separation) ** 2 for c in chosen)
