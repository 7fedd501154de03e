"""The observer's own tip, without anything trained on tips."""

from __future__ import annotations

from typing import ClassVar, Self

from firmware_py.signals import tip_names
from models.learning.graph_writer import GraphWriter
from models.learning.predictors import Array
from models.tip.tip_rows import TipRows

__all__ = ["ObserverTip"]


class ObserverTip:
    name: ClassVar[str] = "observer"
    summary: ClassVar[str] = "the observer's own tip, without a correction"
    variants: ClassVar[tuple[int, ...]] = (0,)

    def __init__(self, variant: int) -> None:
        self.variant = variant

    def fit(self, rows: TipRows) -> Self:
        """See `TipPredictor.fit`."""
        self._columns, self._width = rows.columns(tip_names()), len(rows.names)
        return self

    def predict(self, inputs: Array) -> Array:
        """See `TipPredictor.predict`."""
        return inputs[:, self._columns]

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        """See `TipPredictor.write`."""
        tip = graph.columns(source, self._width, self._columns, "observed")
        graph.node("Identity", [tip], output)
