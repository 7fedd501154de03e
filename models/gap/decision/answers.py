"""Answers to what is missing: nothing, effects of the catalogue, or something outside of it.

Each answer has a probability by multinomial logistic regression on the evidence of a tested search
(`models.gap.decision.evidence`). Its coefficients are fitted to diagnoses of rigs for tuning, whose
hidden effects are known (`python -m bench.gap.calibrate_answers`); `answers.json` holds them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal, get_args

import msgspec
import numpy as np

from models.gap.decision.evidence import FEATURES, Evidence
from models.gap.residuals.spectrum import Array

PATH: Final = Path(__file__).with_name("answers.json")

Answer = Literal["nothing", "catalogue", "outside"]
ANSWERS: Final = get_args(Answer)


class Answers(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Probabilities of the answers; they add up to 1.

    Attributes
    ----------
    nothing : float
        That nothing is missing.
    catalogue : float
        That effects of the catalogue are missing: those named, where any are.
    outside : float
        That an effect is missing which the catalogue lacks.
    """

    nothing: float
    catalogue: float
    outside: float

    @property
    def believed(self) -> bool:
        """Whether what is named is likelier than everything else together."""
        return self.catalogue > self.nothing + self.outside


CATALOGUE_ONLY: Final = Answers(0.0, 1.0, 0.0)
"""Without a learned noise floor nothing tells noise from something outside of the catalogue."""


class AnswerModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Coefficients of the regression; the content of `answers.json`.

    Attributes
    ----------
    sets : int
        Data sets that it was fitted to.
    features : tuple of str
        Names of the evidence.
    intercept : dict of str to float
        By answer.
    coefficient : dict of str to tuple of float
        By answer, one for each feature.
    """

    sets: int
    features: tuple[str, ...]
    intercept: dict[str, float]
    coefficient: dict[str, tuple[float, ...]]

    def answers(self, evidence: Evidence) -> Answers:
        """Probabilities of the answers.

        Parameters
        ----------
        evidence : Evidence
            Of a tested search.
        """
        row = features_of(evidence)
        score = np.array([self.intercept[a] + np.dot(self.coefficient[a], row) for a in ANSWERS])
        weight = np.exp(score - score.max())
        return Answers(*(weight / weight.sum()).tolist())


def features_of(evidence: Evidence) -> Array:
    """Numbers of the evidence, shape (n,)."""
    return np.array([getattr(evidence, name) for name in FEATURES])


def read_answer_model() -> AnswerModel:
    """Regression in use."""
    return msgspec.json.decode(PATH.read_bytes(), type=AnswerModel)
