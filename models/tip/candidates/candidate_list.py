"""Catalogue of the candidates that a training compares, simplest first."""

from __future__ import annotations

from typing import Final

from models.tip.candidates.bend_polynomial import BendPolynomial
from models.tip.candidates.boosted_trees import BoostedTrees
from models.tip.candidates.corrected_tip import CorrectedTip
from models.tip.candidates.observer_tip import ObserverTip
from models.tip.candidates.paper_polynomial import PaperPolynomial
from models.tip.candidates.perceptron import Perceptron
from models.tip.tip_predictor import TipPredictor

__all__ = ["CANDIDATES"]

CANDIDATES: Final[tuple[type[TipPredictor], ...]] = (
    ObserverTip, PaperPolynomial, BendPolynomial, CorrectedTip, BoostedTrees, Perceptron,
)  # fmt: skip
