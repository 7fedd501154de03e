"""Deployed tip predictor: a fitted candidate with its interval and its range, as one ONNX graph.

A prediction is in range if

- no input is NaN,
- every signal of joints and link lies within its training range, or at most 25 % of it beside it,
- the half width of the interval is at most 15 mm on every axis.

**Bound on the innovation.** The interval follows the present bend. A plant with a wrong stiffness
is out of phase with the link, and where its bend passes zero the interval is narrow although
the tip is far away. The root mean square innovation, taken over about a second of motion, is then a
multiple of that in the training motions. If joints move and an innovation exceeds its bound, the
interval is therefore 15 mm wider, so the row is out of range. Standing joints are not tested: a
link that was released leaves as large an innovation with the right plant, and it persists while the
joints stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import AGE
from firmware_py.inference.predictor import TRUSTED_M, InputRange
from models.predictor.candidates import TipPredictor
from models.predictor.interval import STANDING_RAD_S, TipInterval, joint_inputs, write_sums
from models.predictor.observed_trials import TipRows
from models.predictor.onnx_graphs import Array, GraphWriter, evaluate

MARGIN: Final = 0.25
"""Distance by which a signal may leave its training range and still be trusted, as a fraction of
the range [assumed]: the observer extrapolates by its equations, the correction is clipped."""
INNOVATION_FACTOR: Final = 1.5
"""Bound as a multiple of the largest innovation in training rows that move. Chosen on nine rigs for
tuning: 1.25 rejects rows of the right plant, 2 lets errors of 40 mm pass."""
NO_BOUND: Final = float(np.finfo(float).max)


@dataclass(frozen=True)
class GuardedTip:
    """Candidate with its interval and range."""

    names: tuple[str, ...]
    predictor: TipPredictor  # Fitted on all training rows
    interval: TipInterval  # Calibrated on rows that were left out
    lower: Array  # (inputs,), range of every input in the training rows
    upper: Array
    innovation_a: Array  # (dof,), bound above which the interval of moving joints is too narrow

    @classmethod
    def of(cls, rows: TipRows, predictor: TipPredictor, interval: TipInterval) -> GuardedTip:
        """Guard a fitted predictor by the range of its training rows."""
        rates = rows.of(joint_inputs(rows.names, "joint_rate"))
        moving = (rates**2).sum(axis=1) > STANDING_RAD_S**2
        innovation_a = rows.of(joint_inputs(rows.names, "innovation"))[moving]
        bound_a = (
            INNOVATION_FACTOR * innovation_a.max(axis=0)
            if moving.any()
            else np.full(rows.dof, np.sqrt(NO_BOUND))
        )
        lower, upper = rows.inputs.min(axis=0), rows.inputs.max(axis=0)
        return cls(rows.names, predictor, interval, lower, upper, bound_a)

    def predict(self, inputs: Array) -> Array:
        """Tip in m, shape (n, 3)."""
        return self.predictor.predict(inputs)

    def half_width(self, inputs: Array) -> Array:
        """Half width of the 95 % interval in m, shape (n, 3)."""
        return evaluate(self._write_half_width, inputs)

    def in_range(self, inputs: Array) -> NDArray[np.bool_]:
        """Whether the prediction may be trusted, shape (n,)."""

        def write(graph: GraphWriter, source: str) -> str:
            return self._write_in_range(graph, source, self._write_half_width(graph, source))

        return evaluate(write, inputs)[:, 0] > 0.5

    def bounds(self) -> tuple[Array, Array]:
        """Bounds outside which an input is out of range, (inputs,) each.

        Signals of the observer's error have none: they widen the interval.
        """
        margin = MARGIN * (self.upper - self.lower)
        free = [
            name == AGE.name or name.startswith("innovation") or name.endswith("deviation_m")
            for name in self.names
        ]
        return (
            np.where(free, -NO_BOUND, self.lower - margin),
            np.where(free, NO_BOUND, self.upper + margin),
        )

    def ranges(self) -> list[InputRange]:
        """Range of each input in the training rows, and the bounds of the guard, for the robot."""
        innovations = joint_inputs(self.names, "innovation")
        innovation_a = dict(zip(innovations, self.innovation_a.tolist(), strict=True))
        rows = np.column_stack([self.lower, self.upper, *self.bounds()]).tolist()
        ranges = []
        for name, (low, high, least, most) in zip(self.names, rows, strict=True):
            bounds = (None, innovation_a.get(name)) if most == NO_BOUND else (least, most)
            ranges.append(InputRange(name, low, high, bounds))
        return ranges

    def write_graph(self, graph: GraphWriter, source: str) -> None:
        """Write `tip_m`, `half_width_m` and `in_range`."""
        self.predictor.write(graph, source, "tip_m")
        half_width = self._write_half_width(graph, source, "half_width_m")
        self._write_in_range(graph, source, half_width, "in_range")

    def _write_half_width(self, graph: GraphWriter, source: str, output: str | None = None) -> str:
        """Write the interval, wider by 15 mm where joints move and an innovation is too large."""
        innovations = joint_inputs(self.names, "innovation")
        groups = [*([name] for name in innovations), joint_inputs(self.names, "joint_rate")]
        total = write_sums(graph, source, self.names, groups)
        above = graph.bits(total, np.append(self.innovation_a, STANDING_RAD_S) ** 2, "above")
        # The sum exceeds dof only with the moving bit and at least one other.
        dof = len(innovations)
        votes = np.array([[1.0]] * dof + [[float(dof)]])
        count = graph.temporary("MatMul", [above, votes], "above_count")
        exceeded = graph.bits(count, np.array([dof + 0.5]), "exceeded")
        widening = graph.temporary("MatMul", [exceeded, np.full((1, 3), TRUSTED_M)], "widening")
        usual = self.interval.write(graph, source)
        return graph.node("Add", [usual, widening], output or graph.unique("half_width"))

    def _write_in_range(
        self, graph: GraphWriter, source: str, half_width: str, output: str | None = None
    ) -> str:
        _, inside = graph.inside(source, *self.bounds())
        wide = graph.bits(half_width, np.full(3, TRUSTED_M), "wide")
        doubts = graph.temporary("MatMul", [wide, -np.ones((3, 1))], "doubts")
        votes = graph.temporary("Add", [inside, doubts], "votes")
        return graph.bits(votes, np.array([len(self.names) - 0.5]), "trusted", output)
