"""Answers to what is missing: nothing, effects of the catalogue, or something outside of it.

Two logistic regressions on the evidence of a tested search (`models.gap.decision.evidence`) give
the probabilities: whether the named effects are what is missing, and if not, whether anything is. A
name that fits badly is no evidence for the latter: where nothing is missing, the plant's own error
yields names that fit as badly. The gain of a further effect beside the named ones is evidence.
Currents and tip count separately there: a changed link adds more error at the tip than in the
currents. How far the nuisance moved is no evidence for the former: a faint effect on an unchanged
link moves it as little as no effect does. The coefficients are fitted to diagnoses of rigs for
tuning, whose hidden effects are known (`python -m models.gap.training answers`);
`answers.json` holds them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

import msgspec
import numpy as np
from scipy.special import expit

from models.gap.decision.evidence import Evidence

PATH: Final = Path(__file__).with_name("answers.json")

Answer = Literal["nothing", "catalogue", "outside"]

OF_NAMES: Final = (
    "named", "beyond_one", "gap", "left", "clearness", "difference", "rise", "further", "rival",
)  # fmt: skip
"""Evidence that separates the missing effects from their stand-ins."""

OF_A_GAP: Final = ("clearness", "further", "servo", "tip")
"""Evidence that separates something outside of the catalogue from nothing."""


WRONG_NAME_COST: Final = 2.0
"""Cost of a wrong name, relative to any other mistake: somebody looks for an effect that is not
there, and the plant that is written has it [assumed]."""


class Answers(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Probabilities of the answers; they add up to 1."""

    nothing: float  # Nothing is missing
    catalogue: float  # Effects of the catalogue are missing: the named ones, if there are any
    outside: float  # An effect is missing that the catalogue lacks

    @property
    def is_believed(self) -> bool:
        """Whether effects are named: their expected cost is less than that of the next most
        probable answer.

        The least expected cost decides, as in Bayesian decision theory. Effects are named above two
        thirds where the alternative is clear, and above 60 % where something outside is as probable
        as nothing.
        """
        return WRONG_NAME_COST * (1 - self.catalogue) < 1 - max(self.outside, self.nothing)

    @property
    def is_outside(self) -> bool:
        """Whether something outside of the catalogue is more probable than nothing."""
        return self.outside > self.nothing

    def without_nothing(self) -> Answers:
        """The same answers when something is known to be missing."""
        return Answers(0.0, self.catalogue, self.outside + self.nothing)


CATALOGUE_ONLY: Final = Answers(0.0, 1.0, 0.0)
"""Without a learned noise floor, noise cannot be separated from something outside of
the catalogue."""


class Regression(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Logistic regression on the evidence."""

    intercept: float  # Logarithm of the odds where all evidence is zero
    coefficient: dict[str, float]  # By name of the evidence
    # Range of each kind of evidence that counts: extreme values are rare and prove no more than
    # usual ones. Evidence that is not listed counts in full.
    bounds: dict[str, tuple[float, float]]
    # Logarithm of the odds by effect, the mean of several: some effects stand in for others more
    # often. 0 for an effect that is not listed.
    of_effect: dict[str, float]

    def probability(self, evidence: Evidence, named: Sequence[str]) -> float:
        """Probability of the outcome that was fitted."""
        of_effects = sum(self.of_effect.get(effect, 0.0) for effect in named)
        log_odds = self.intercept + of_effects / max(len(named), 1)
        for name, coefficient in self.coefficient.items():
            value = getattr(evidence, name)
            if name in self.bounds:
                value = float(np.clip(value, *self.bounds[name]))
            log_odds += coefficient * value
        return float(expit(log_odds))


class AnswerModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Both regressions; the content of `answers.json`."""

    sets: int  # Tests that they were fitted to
    # Regression of the answer "catalogue", on evidence that separates names from stand-ins
    # (`OF_NAMES`)
    catalogue: Regression
    # Regression of "outside" where the catalogue holds nothing that is missing (`OF_A_GAP`)
    outside: Regression

    def answers(self, evidence: Evidence, named: Sequence[str]) -> Answers:
        catalogue = self.catalogue.probability(evidence, named)
        outside = (1 - catalogue) * self.outside.probability(evidence, named)
        return Answers(1 - catalogue - outside, catalogue, outside)


def set_order(effects: int, believed: bool, probability: float) -> tuple[int, float]:
    """Sort key of the sets of effects that one data set was tested for; the largest decides.

    It grows with the number of effects that are probable enough to be named, then with their
    probability: fewer effects are always more probable.
    """
    return believed * effects, probability


def read_answer_model() -> AnswerModel:
    return msgspec.json.decode(PATH.read_bytes(), type=AnswerModel)
