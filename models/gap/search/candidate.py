"""What the search for a missing effect handles: candidates, and what was found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint

ALIKE: Final = 3.0
"""Separation below which two effects cannot be told apart
(docs/sources.md, "Naming a missing effect")."""


@dataclass
class Candidate:
    """A candidate (one effect, or two) and its fit."""

    effects: tuple[str, ...]
    point: FitPoint
    gain: float
    least: float
    promised: float = 0.0
    held_out_gain: float = np.nan
    held_out_error: float = np.nan

    @property
    def score(self) -> float:
        """Twice the gain, less what it must be at least."""
        return 2 * self.gain - self.least**2

    @property
    def separation(self) -> float:
        """Its d′: root of twice the fall of the cost."""
        return float(np.sqrt(max(2 * self.gain, 0.0)))


@dataclass
class SearchResult:
    """What the search found.

    Attributes
    ----------
    before, after : FitPoint
        Fit of nuisance and trial variation alone, and with what was named.
    named : list of str
        In order of inclusion.
    rounds : list of list of Candidate
        Refitted candidates of each round, best first.
    screened : dict of str to float
        d′ of every effect in the first round's screen.
    unexcited : list of str
        Effects that these trials could not show at any strength within bounds.
    """

    before: FitPoint
    after: FitPoint
    named: list[str] = field(default_factory=list)
    rounds: list[list[Candidate]] = field(default_factory=list)
    screened: dict[str, float] = field(default_factory=dict)
    unexcited: list[str] = field(default_factory=list)
    chosen: list[Candidate] = field(default_factory=list)
