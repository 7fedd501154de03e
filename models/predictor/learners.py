"""Gradient-boosted trees that correct the observer's tip.

Small multi-layer perceptron that corrects the observer's tip.

Catalogue of the candidates that a training compares, simplest first.
"""

from __future__ import annotations

import warnings
from typing import Any, ClassVar, Final, Self

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor

from firmware_py.signals import PAYLOAD, tip_names
from models.predictor.candidates import (
    BendPolynomial,
    CorrectedTip,
    ObserverTip,
    PaperPolynomial,
    TipPredictor,
    motion_names,
)
from models.predictor.observed_trials import TipRows
from models.predictor.onnx_graphs import GraphWriter
from models.predictor.polynomials import Array

ITERATIONS: Final = 30
LEARNING_RATE: Final = 0.15
SMALLEST_LEAF: Final = 40
"""Fewest rows in a leaf: 0.7 s of motion. All three [assumed]."""
DECIMALS: Final = 9
"""Digits to which inputs are rounded before training, in SI units. Otherwise a split could lie
between values that differ only by rounding, such as those of a joint at rest, and a graph from
another compiler would take the other branch."""


class BoostedTrees:
    """Correction of the observer's tip by boosted trees; the variant is their depth.

    A tree is written as the product of its comparisons: each leaf has a factor per level, the
    comparison or its complement, so that one row of leaves represents all trees.
    """

    name: ClassVar[str] = "boosted trees"
    summary: ClassVar[str] = "the observer's tip with a correction by gradient-boosted trees"
    variants: ClassVar[tuple[int, ...]] = (2,)

    def __init__(self, variant: int) -> None:
        self.variant = variant

    def fit(self, rows: TipRows) -> Self:
        """See `TipPredictor.fit`."""
        self._columns = rows.columns((*motion_names(rows.dof), PAYLOAD.name))
        self._base, self._width = rows.columns(tip_names()), len(rows.names)
        error_m = rows.tip_m - rows.observer_tip_m
        chosen = rows.inputs[:, self._columns].round(DECIMALS)
        self._trees = [
            HistGradientBoostingRegressor(
                max_iter=ITERATIONS, max_depth=self.variant, learning_rate=LEARNING_RATE,
                min_samples_leaf=SMALLEST_LEAF, early_stopping=False, random_state=0,
            ).fit(chosen, error_m[:, axis])
            for axis in range(3)
        ]  # fmt: skip
        for trees in self._trees:
            for (tree,) in trees._predictors:  # move splits between two rounded values
                tree.nodes["num_threshold"] += 0.5 * 10.0**-DECIMALS
        return self

    def predict(self, inputs: Array) -> Array:
        """See `TipPredictor.predict`."""
        chosen = inputs[:, self._columns]
        correction_m = np.column_stack([trees.predict(chosen) for trees in self._trees])
        return np.asarray(inputs[:, self._base] + correction_m)

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        """See `TipPredictor.write`."""
        features = graph.columns(source, self._width, self._columns, "features")
        leaves = [
            (axis, *leaf)
            for axis, trees in enumerate(self._trees)
            for tree in trees._predictors
            for leaf in _leaves(tree[0].nodes)
        ]
        values = np.zeros((len(leaves), 3))
        for k, (axis, value, _) in enumerate(leaves):
            values[k, axis] = value
        product = ""
        for level in range(self.variant):
            column = np.zeros((len(self._columns), len(leaves)))
            threshold = np.full(len(leaves), -1.0)  # an absent comparison: 0 is above it
            sign, constant = np.ones(len(leaves)), np.zeros(len(leaves))
            for k, (_, _, path) in enumerate(leaves):
                if level < len(path):
                    feature, bound, right = path[level]
                    column[feature, k], threshold[k] = 1.0, bound
                    sign[k], constant[k] = (1.0, 0.0) if right else (-1.0, 1.0)
            stem = f"level_{level}"
            seen = graph.temporary("MatMul", [features, graph.constant(f"{stem}_of", column)], stem)
            bits = graph.bits(seen, threshold, stem)
            signed = graph.temporary(
                "Mul", [bits, graph.constant(f"{stem}_sign", sign[None])], f"{stem}_signed"
            )
            factor = graph.temporary(
                "Add", [signed, graph.constant(f"{stem}_constant", constant[None])], f"{stem}_is"
            )
            product = graph.temporary("Mul", [product, factor], "leaf") if product else factor
        base = graph.columns(source, self._width, self._base, "base")
        start = np.array([np.ravel(trees._baseline_prediction)[0] for trees in self._trees])
        base = graph.temporary("Add", [base, graph.constant("start", start[None])], "started")
        grown = graph.temporary("MatMul", [product, graph.constant("values", values)], "grown")
        graph.node("Add", [base, grown], output)


def _leaves(nodes: Any) -> list[tuple[float, list[tuple[int, float, bool]]]]:
    """Leaves of a tree: value, and the comparisons on its path (feature, bound, whether above)."""
    found = []

    def walk(k: int, path: list[tuple[int, float, bool]]) -> None:
        node = nodes[k]
        if node["is_leaf"]:
            found.append((float(node["value"]), path))
            return
        feature, bound = int(node["feature_idx"]), float(node["num_threshold"])
        walk(int(node["left"]), [*path, (feature, bound, False)])
        walk(int(node["right"]), [*path, (feature, bound, True)])

    walk(0, [])
    return found


ROWS: Final = 1500
"""Most rows to fit on, equally spaced, because neighbours are nearly equal."""
ITERATIONS_perceptron: Final = 80
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
            max_iter=ITERATIONS_perceptron, random_state=0,
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


CANDIDATES: Final[tuple[type[TipPredictor], ...]] = (
    ObserverTip, PaperPolynomial, BendPolynomial, CorrectedTip, BoostedTrees, Perceptron,
)  # fmt: skip
