"""Answers to what is missing: nothing, effects of the catalogue, or something outside of it.

Two logistic regressions on the evidence of a tested search (`models.gap.decision.evidence`) give
the probabilities: whether the named effects are what is missing, and if not, whether anything is.
A name that does not fit says nothing about the latter: where nothing is missing, the plant's own
error bears names that fit as badly. What a further effect would explain beside it does. Currents
and tip count apart there: what a changed link adds to the plant's own error is at the tip rather
than in the currents. How far the nuisance moved says
nothing about the former: a faint effect on an unchanged link moves it as little as no effect does.
The coefficients are fitted to diagnoses of rigs for tuning, whose hidden effects are known
(`python -m models.gap.training answers`); `answers.json` holds them.
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
"""Evidence that tells the missing effects from what stands in for them."""

OF_A_GAP: Final = ("clearness", "further", "servo", "tip")
"""Evidence that tells something outside of the catalogue from nothing."""


WRONG_NAME_COST: Final = 2.0
"""Cost of a wrong name, over that of any other mistake: somebody looks for an effect that is not
there, and the plant that is written has it [assumed]."""


class Answers(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Probabilities of the answers; they add up to 1."""

    nothing: float
    catalogue: float  # That effects of the catalogue are missing: those named, where any are
    outside: float  # That an effect is missing which the catalogue lacks

    @property
    def is_believed(self) -> bool:
        """Whether names are given: they cost less in the mean than the likelier other answer.

        The least expected cost decides, as in Bayesian decision theory. Names are given beyond
        two thirds where it is known what else it would be, and beyond 60 % where something outside
        is as likely as nothing.
        """
        return WRONG_NAME_COST * (1 - self.catalogue) < 1 - max(self.outside, self.nothing)

    @property
    def is_outside(self) -> bool:
        """Whether something outside of the catalogue is likelier than nothing."""
        return self.outside > self.nothing

    def without_nothing(self) -> Answers:
        """The same where something is known to be missing."""
        return Answers(0.0, self.catalogue, self.outside + self.nothing)


CATALOGUE_ONLY: Final = Answers(0.0, 1.0, 0.0)
"""Without a learned noise floor nothing tells noise from something outside of the catalogue."""


class Regression(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Logistic regression on the evidence."""

    intercept: float  # Logarithm of the odds where all evidence is zero
    coefficient: dict[str, float]  # By name of the evidence
    # Least and largest value that counts, by name of the evidence: extreme values are rare and
    # prove no more than usual ones. Evidence that is missing here counts in full.
    bounds: dict[str, tuple[float, float]]
    # Logarithm of the odds by effect, of several their mean: some effects stand in for others more
    # often than others do. 0 for one that is missing here.
    of_effect: dict[str, float]

    def probability(self, evidence: Evidence, named: Sequence[str]) -> float:
        """Probability of what was fitted."""
        of_effects = sum(self.of_effect.get(effect, 0.0) for effect in named)
        log_odds = self.intercept + of_effects / max(len(named), 1)
        for name, coefficient in self.coefficient.items():
            value = getattr(evidence, name)
            if name in self.bounds:
                value = float(np.clip(value, *self.bounds[name]))
            log_odds += coefficient * value
        return float(expit(log_odds))


class AnswerModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Regressions in use; the content of `answers.json`."""

    sets: int  # Tests that they were fitted to
    # Of the answer "catalogue", on what tells names from stand-ins (`OF_NAMES`)
    catalogue: Regression
    # Of "outside" where the catalogue holds nothing that is missing, on what exceeds noise
    # (`OF_A_GAP`)
    outside: Regression

    def answers(self, evidence: Evidence, named: Sequence[str]) -> Answers:
        """Probabilities of the answers."""
        catalogue = self.catalogue.probability(evidence, named)
        outside = (1 - catalogue) * self.outside.probability(evidence, named)
        return Answers(1 - catalogue - outside, catalogue, outside)


def set_order(effects: int, believed: bool, probability: float) -> tuple[int, float]:
    """Order of the sets of effects that one data set was tested for; the largest is decided on.

    It grows with the effects that are believed, then with the belief in them: fewer effects are
    always likelier to be right.
    """
    return believed * effects, probability


def read_answer_model() -> AnswerModel:
    """Regressions in use."""
    return msgspec.json.decode(PATH.read_bytes(), type=AnswerModel)
