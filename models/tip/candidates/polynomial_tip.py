"""Polynomials of some inputs, whose value is the tip or a correction of the observer's tip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np
from sklearn.pipeline import Pipeline

from firmware_py.signals import tip_names
from models.learning.graph_writer import GraphWriter
from models.learning.predictors import Array, Polynomial, polynomial_pipeline, predict
from models.tip.tip_rows import TipRows

__all__ = ["PolynomialTip", "motion_names"]


def motion_names(dof: int) -> tuple[str, ...]:
    """Signed state of joints and link: angle, its rate, bend and its rate."""
    kinds = ("angle_{j}_rad", "joint_rate_{j}_rad_s", "bend_{j}_rad", "bend_rate_{j}_rad_s")
    return tuple(kind.format(j=j) for kind in kinds for j in range(1, dof + 1))


class PolynomialTip:
    """Polynomial of selected inputs, clipped to their training box, added to a base."""

    name: ClassVar[str]
    summary: ClassVar[str]
    variants: ClassVar[tuple[int, ...]]
    corrects: ClassVar[bool]

    def __init__(self, variant: int) -> None:
        self.variant = variant

    def chosen(self, dof: int) -> Sequence[str]:
        """Names of the inputs of the polynomial."""
        raise NotImplementedError

    def fit(self, rows: TipRows) -> Self:
        """See `TipPredictor.fit`."""
        self._columns = rows.columns(self.chosen(rows.dof))
        self._base = rows.columns(tip_names())
        self._width = len(rows.names)
        target_m = rows.tip_m - rows.observer_tip_m if self.corrects else rows.tip_m
        self._pipeline: Pipeline | None = None
        if self.variant:
            features = rows.inputs[:, self._columns]
            self._lower, self._upper = features.min(axis=0), features.max(axis=0)
            self._pipeline = polynomial_pipeline(self.variant).fit(features, target_m)
        return self

    def predict(self, inputs: Array) -> Array:
        """See `TipPredictor.predict`."""
        base_m = inputs[:, self._base] if self.corrects else np.zeros((len(inputs), 3))
        if self._pipeline is None:
            return base_m
        clipped = np.clip(inputs[:, self._columns], self._lower, self._upper)
        return base_m + predict(self._pipeline, clipped)

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        """See `TipPredictor.write`."""
        terms = []
        if self.corrects:
            terms.append(graph.columns(source, self._width, self._base, "base"))
        if self._pipeline is not None:
            features = graph.columns(source, self._width, self._columns, "features")
            clipped = graph.clipped(features, self._lower, self._upper)
            name = graph.scope.get_unique_variable_name("polynomial")
            terms.append(graph.polynomial(clipped, Polynomial.of(self._pipeline), "tip", name))
        graph.node("Add" if len(terms) > 1 else "Identity", terms, output)
