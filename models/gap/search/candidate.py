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
    """A candidate (one effect, or two) and its fit.

    Attributes
    ----------
    effects : tuple of str
        Names.
    point : FitPoint
        Where the fit ended.
    gain : float
        Fall of the cost.
    least : float
        Least d′ that the effects must reach.
    predicted : float
        Fall of the cost that derivatives predict.
    held_out_gain, held_out_error : float
        Fall of the cost on trials left out, and what it must exceed; not a number before
        cross-validation.
    held : frozenset of int
        Fit parameters of its own that keep their first value because they ended at a bound.
    """

    effects: tuple[str, ...]
    point: FitPoint
    gain: float
    least: float
    predicted: float = 0.0
    held_out_gain: float = np.nan
    held_out_error: float = np.nan
    held: frozenset[int] = frozenset()

    @property
    def score(self) -> float:
        """Twice the gain, less the square of the least d′."""
        return 2 * self.gain - self.least**2

    @property
    def hope(self) -> float:
        """Score that a screened candidate may reach, halfway to the prediction of derivatives."""
        return self.score + max(self.predicted - self.gain, 0.0)

    @property
    def separation(self) -> float:
        """Its d′: root of twice the fall of the cost."""
        return float(np.sqrt(max(2 * self.gain, 0.0)))

    def missed_fraction(self, settings: GapSettings) -> float:
        """Fraction of d′ that the equations of the effects may miss.

        Parameters
        ----------
        settings : GapSettings
            Tuned numbers.
        """
        by_port = settings.further_effect_fraction_by_port
        general = settings.further_effect_fraction
        return max(by_port.get(EFFECTS[e].port, general) for e in self.effects)


@dataclass
class SearchResult:
    """Result of the effect search.

    Attributes
    ----------
    before, after : FitPoint
        Fit of nuisance and trial variation alone, and with the named effects.
    named : list of str
        In order of inclusion, without those deleted again.
    rounds : list of list of Candidate
        Refitted candidates of each round, best first.
    screened : dict of str to float
        d′ of every effect in the first round's screen.
    unexcited : list of str
        Effects that these trials could not show at any strength within bounds.
    chosen : list of Candidate
        Included in each round.
    refused : list of RefusedEffect
        Candidates whose strength ended at a bound, and what the acceptance takes out.
    explored : dict of frozenset of str to FitPoint
        Best fit of each set of effects that was tried, against the same floor.
    """

    before: FitPoint
    after: FitPoint
    named: list[str] = field(default_factory=list)
    rounds: list[list[Candidate]] = field(default_factory=list)
    screened: dict[str, float] = field(default_factory=dict)
    unexcited: list[str] = field(default_factory=list)
    chosen: list[Candidate] = field(default_factory=list)
    refused: list[RefusedEffect] = field(default_factory=list)
    explored: dict[frozenset[str], FitPoint] = field(default_factory=dict)

    def explore(self, effects: Sequence[str], point: FitPoint) -> None:
        """Keep a fit of a set of effects where it is the best so far."""
        key = frozenset(effects)
        if key not in self.explored or point.cost < self.explored[key].cost:
            self.explored[key] = point
