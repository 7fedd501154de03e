"""Bound on the innovation of the currents, above which the interval of moving joints is too narrow.

The interval follows the present bend. A plant with a wrong stiffness is out of phase with the link,
and where its own bend passes zero the interval is narrow although the tip is far away. The root
mean square innovation, taken over about a second of motion, is then a multiple of that in the
training motions. Only moving joints are tested: a link that was released leaves as large an
innovation with the right plant, and it persists while the joints stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.learning.graph_writer import GraphWriter
from models.learning.predictors import Array
from models.tip.tip_interval import STANDING_RAD_S
from models.tip.tip_rows import TipRows

__all__ = ["InnovationBound"]

FACTOR: Final = 1.5
"""Bound as a multiple of the largest innovation in training rows that move. Chosen on nine rigs for
tuning: 1.25 rejects rows of the right plant, 2 lets errors of 40 mm pass."""
NONE_A: Final = float(np.sqrt(np.finfo(float).max))
"""Bound that nothing exceeds."""


@dataclass(frozen=True)
class InnovationBound:
    """Bound on the innovation of each joint."""

    names: tuple[str, ...]
    bound_a: Array  # (dof,), root mean square innovation above which the interval is too narrow

    @classmethod
    def of(cls, rows: TipRows) -> InnovationBound:
        """Bound from training rows with the right plant; none if no joint moves."""
        squares = rows.inputs**2 @ _sums(rows.names, rows.dof)
        moving = squares[:, -1] > STANDING_RAD_S**2
        if not moving.any():
            return cls(rows.names, np.full(rows.dof, NONE_A))
        return cls(rows.names, FACTOR * np.sqrt(squares[moving, :-1].max(axis=0)))

    def exceeded(self, inputs: Array) -> NDArray[np.bool_]:
        """Where joints move and an innovation exceeds its bound, shape (n,)."""
        above = inputs**2 @ _sums(self.names, len(self.bound_a)) > self._thresholds()
        return np.asarray(above[:, :-1].any(axis=1) & above[:, -1])

    def write(self, graph: GraphWriter, source: str) -> str:
        """Write 1.0 where joints move and an innovation exceeds its bound, else 0.0.

        Returns the name of the result, shape (1, 1).
        """
        dof = len(self.bound_a)
        square = graph.temporary("Mul", [source, source], "bounded")
        sums = graph.constant("bounded_sums", _sums(self.names, dof))
        total = graph.temporary("MatMul", [square, sums], "bounded_total")
        above = graph.bits(total, self._thresholds(), "above")
        # The sum exceeds dof only with the moving bit and at least one other.
        votes = graph.constant("above_votes", np.array([[1.0]] * dof + [[float(dof)]]))
        count = graph.temporary("MatMul", [above, votes], "above_count")
        return graph.bits(count, np.array([dof + 0.5]), "exceeded")

    def _thresholds(self) -> Array:
        return np.append(self.bound_a, STANDING_RAD_S) ** 2


def _sums(names: tuple[str, ...], dof: int) -> Array:
    """Matrix from squared inputs to the squared innovation of each joint and that of all rates."""
    sums = np.zeros((len(names), dof + 1))
    for joint in range(dof):
        sums[names.index(f"innovation_{joint + 1}_a"), joint] = 1.0
        sums[names.index(f"joint_rate_{joint + 1}_rad_s"), dof] = 1.0
    return sums
