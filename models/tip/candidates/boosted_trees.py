"""Gradient-boosted trees that correct the observer's tip."""

from __future__ import annotations

from typing import Any, ClassVar, Final, Self

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor

from firmware_py.signals import PAYLOAD, tip_names
from models.learning.graph_writer import GraphWriter
from models.learning.predictors import Array
from models.tip.candidates.polynomial_tip import motion_names
from models.tip.tip_rows import TipRows

__all__ = ["BoostedTrees"]

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
