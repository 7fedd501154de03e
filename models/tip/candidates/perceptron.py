"""Small multi-layer perceptron that corrects the observer's tip."""

from __future__ import annotations

import warnings
from typing import ClassVar, Final, Self

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor

from firmware_py.signals import PAYLOAD, tip_names
from models.learning.graph_writer import GraphWriter
from models.learning.predictors import Array
from models.tip.candidates.polynomial_tip import motion_names
from models.tip.tip_rows import TipRows

__all__ = ["Perceptron"]

ROWS: Final = 1500
"""Most rows to fit on, equally spaced, because neighbours are nearly equal."""
ITERATIONS: Final = 80
PENALTY: Final = 0.1
"""L2 penalty of scikit-learn, against overfitting to few trials [assumed]."""
CORRECTION_M: Final = 1e-3
"""Unit of the fitted correction."""


class Perceptron:
    """Correction of the observer's tip by one hidden layer; the variant is its width."""

    name: ClassVar[str] = "perceptron"
    summary: ClassVar[str] = (
        "the observer's tip with a correction by a small multi-layer perceptron"
    )
    variants: ClassVar[tuple[int, ...]] = (8,)

    def __init__(self, variant: int) -> None:
        self.variant = variant

    def fit(self, rows: TipRows) -> Self:
        """See `TipPredictor.fit`."""
        self._columns = rows.columns((*motion_names(rows.dof), PAYLOAD.name))
        self._base, self._width = rows.columns(tip_names()), len(rows.names)
        chosen = np.unique(np.linspace(0, len(rows) - 1, min(ROWS, len(rows))).round().astype(int))
        few = rows.take(chosen)
        features = few.inputs[:, self._columns]
        self._lower, self._upper = features.min(axis=0), features.max(axis=0)
        self._offset, self._scale = features.mean(axis=0), features.std(axis=0) + 1e-12
        self._net = MLPRegressor(
            hidden_layer_sizes=(self.variant,), activation="tanh", solver="lbfgs", alpha=PENALTY,
            max_iter=ITERATIONS, random_state=0,
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # the limit is a regularisation
            self._net.fit(self._scaled(features), (few.tip_m - few.observer_tip_m) / CORRECTION_M)
        return self

    def _scaled(self, features: Array) -> Array:
        clipped = np.clip(features, self._lower, self._upper)
        return np.asarray((clipped - self._offset) / self._scale)

    def predict(self, inputs: Array) -> Array:
        """See `TipPredictor.predict`."""
        correction = self._net.predict(self._scaled(inputs[:, self._columns]))
        return np.asarray(inputs[:, self._base] + CORRECTION_M * correction)

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        """See `TipPredictor.write`."""
        features = graph.columns(source, self._width, self._columns, "features")
        clipped = graph.clipped(features, self._lower, self._upper)
        (first, second), (bias, last) = self._net.coefs_, self._net.intercepts_
        rows = first / self._scale[:, None]
        hidden = graph.temporary(
            "Gemm",
            [clipped, graph.constant("rows", rows),
             graph.constant("bias", bias - self._offset @ rows)],
            "hidden",
        )  # fmt: skip
        active = graph.temporary("Tanh", [hidden], "active")
        correction = graph.temporary(
            "Gemm",
            [active, graph.constant("weights", CORRECTION_M * second),
             graph.constant("constant", CORRECTION_M * last)],
            "correction",
        )  # fmt: skip
        base = graph.columns(source, self._width, self._base, "base")
        graph.node("Add", [base, correction], output)
