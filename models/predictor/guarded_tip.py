"""Deployed tip predictor: a fitted candidate with its guard and its interval, as one ONNX graph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import onnx
from numpy.typing import NDArray

from firmware_py.signals import AGE
from models.predictor.candidates import TipPredictor
from models.predictor.interval import InnovationBound, TipInterval
from models.predictor.observed_trials import TipRows
from models.predictor.onnx_graphs import GraphWriter, register_model
from models.predictor.polynomials import Array

MARGIN: Final = 0.25
"""Distance by which a signal may leave its training range and still be trusted, as a fraction of
the range [assumed]: the observer extrapolates by its equations, the correction is clipped."""
TRUSTED_M: Final = 0.015
"""Largest half width of the interval that counts as a prediction: 1.5 % of the link
(requirement)."""


@dataclass(frozen=True)
class GuardedTip:
    """Candidate with its guard and interval.

    `in_range` is true if no input is NaN, the inputs of joints and link lie within their training
    range and a margin, and the interval is no wider than `TRUSTED_M` on any axis. If joints move
    and an innovation exceeds its bound, the interval is wider by `TRUSTED_M`, so the row is out of
    range.
    """

    names: tuple[str, ...]
    predictor: TipPredictor  # Fitted on all training rows
    interval: TipInterval  # Calibrated on rows that were left out
    lower: Array  # (inputs,), range of every input in the training rows
    upper: Array
    innovation: InnovationBound  # Bound from the training rows

    @classmethod
    def of(cls, rows: TipRows, predictor: TipPredictor, interval: TipInterval) -> GuardedTip:
        """Guard a fitted predictor by the range of its training rows."""
        lower, upper = rows.inputs.min(axis=0), rows.inputs.max(axis=0)
        return cls(rows.names, predictor, interval, lower, upper, InnovationBound.of(rows))

    def predict(self, inputs: Array) -> Array:
        """Tip in m, shape (n, 3)."""
        return self.predictor.predict(inputs)

    def half_width(self, inputs: Array) -> Array:
        """Half width of the 95 % interval in m, shape (n, 3)."""
        exceeded = self.innovation.exceeded(inputs)
        return self.interval.half_width(inputs) + TRUSTED_M * exceeded[:, None]

    def guard(self) -> tuple[Array, Array]:
        """Bounds outside which an input is out of range, (inputs,) each.

        Signals of the observer's own error have no bounds: they widen the interval.
        """
        margin = MARGIN * (self.upper - self.lower)
        free = [
            name == AGE.name or name.startswith("innovation") or name.endswith("deviation_m")
            for name in self.names
        ]
        return (
            np.where(free, -np.finfo(float).max, self.lower - margin),
            np.where(free, np.finfo(float).max, self.upper + margin),
        )

    def in_range(self, inputs: Array) -> NDArray[np.bool_]:
        """Whether the prediction may be trusted, shape (n,)."""
        lower, upper = self.guard()
        inside = ((inputs >= lower) & (inputs <= upper)).all(axis=1)
        return np.asarray(inside & ~(self.half_width(inputs) > TRUSTED_M).any(axis=1))


def _convert(scope: Any, operator: Any, container: Any) -> None:
    model: GuardedTip = operator.raw_operator
    graph = GraphWriter(scope, container)
    source = operator.inputs[0].full_name
    tip, in_range, half_width = (variable.full_name for variable in operator.outputs)
    model.predictor.write(graph, source, tip)
    usual = model.interval.write(graph, source)
    exceeded = model.innovation.write(graph, source)
    widening = graph.constant("widening", np.full((1, 3), TRUSTED_M))
    widening = graph.temporary("MatMul", [exceeded, widening], "widening")
    graph.node("Add", [usual, widening], half_width)

    clipped = graph.clipped(source, *model.guard())
    same = graph.temporary("Equal", [clipped, source], "same")
    same = graph.temporary("Cast", [same], "same_number", to=onnx.TensorProto.DOUBLE)
    count = len(model.names)
    inside = graph.temporary("MatMul", [same, graph.constant("ones", np.ones((count, 1)))], "in")
    wide = graph.bits(half_width, np.full(3, TRUSTED_M), "wide")
    doubts = graph.temporary("MatMul", [wide, graph.constant("doubts", -np.ones((3, 1)))], "doubts")
    votes = graph.temporary("Add", [inside, doubts], "votes")
    every = graph.constant("every", np.full((1, 1), count - 0.5))
    trusted = graph.temporary("Greater", [votes, every], "trusted")
    graph.node("Cast", [trusted], in_range, to=onnx.TensorProto.DOUBLE)


register_model(GuardedTip, _convert, lambda _: {"tip_m": 3, "in_range": 1, "half_width_m": 3})
