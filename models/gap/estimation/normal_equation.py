"""Sums of squares over groups of trials, and the scaled normal equation of least squares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.plant.identification.noise_floor import Array


def stacked(rows: Sequence[Array]) -> Array:
    """Rows (trials, signals, K[, columns]) of all groups as one matrix (all rows, columns or 1)."""
    return np.concatenate([r.reshape(math.prod(r.shape[:3]), math.prod(r.shape[3:])) for r in rows])


def sum_of_squares(rows: Sequence[Array]) -> float:
    return sum(float(np.sum(r**2)) for r in rows)


def mean_square(rows: Sequence[Array]) -> float:
    return sum_of_squares(rows) / sum(r.size for r in rows)


@dataclass(frozen=True)
class NormalEquation:
    """J'J x = J'r with rows and columns scaled to a unit diagonal."""

    scaled: Array  # (k, k), J'J with a diagonal of ones
    size: Array  # (k,), root of the diagonal of J'J

    @classmethod
    def of(cls, normal: Array, index: NDArray[np.intp] | None = None) -> NormalEquation:
        """Equation of a matrix J'J, or of some of its rows and columns.

        Shapes: `normal` (n, n), `index` (k,).
        """
        matrix = normal if index is None else normal[np.ix_(index, index)]
        size = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
        return cls(matrix / np.outer(size, size), size)

    def regular(self, ridge: float) -> Array:
        """Scaled matrix with a ridge on its diagonal."""
        return np.asarray(self.scaled + ridge * np.eye(len(self.size)))

    def solve(self, right: Array, ridge: float) -> Array:
        """Solution x for the right-hand side J'r, shape (k,) or (k, columns).

        Shapes: `right` (k,) or (k, columns).
        """
        size = self.size if right.ndim == 1 else self.size[:, None]
        return np.asarray(np.linalg.solve(self.regular(ridge), right / size) / size)

    def inverse(self) -> Array:
        """Pseudo-inverse of J'J: the covariance of the solution."""
        inverse = np.linalg.pinv(self.scaled, hermitian=True)
        return np.asarray(inverse / np.outer(self.size, self.size))
