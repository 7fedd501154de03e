"""Generalised least squares over the knobs, in units of the noise floor.

The cost of values θ is ½ |W (r(θ) − m)|² + ½ Σ (θ_k / spread_k)²: W whitens by the floor and by the
patterns of the plant's own error, m is what is known of that error, the second part holds nuisance
and trial variation to their priors. Gauss–Newton steps stay in the bounds and are taken only where
the cost falls. Exact derivatives cost twenty simulations, so between them they are
carried on by secants (Broyden 1965).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.optimize import lsq_linear

from models.gap.estimation.model_discrepancy import discrepancy_of
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.residuals.residuals import Residuals
from models.gap.residuals.spectrum import Array

CONVERGED: Final = 0.3
"""Fall of twice the cost (in squared noise floors) that is not worth another step."""


@dataclass
class FitPoint:
    """Where the knobs stand, and what is left there.

    Attributes
    ----------
    values : ndarray, shape (knobs,)
        Of all knobs.
    cost : float
        See the module's text.
    rows : list of ndarray
        Residual spectra, as `Residuals.residuals`.
    """

    values: Array
    cost: float
    rows: list[Array]
    normal: Array = field(repr=False, default_factory=lambda: np.empty(0))
    gradient: Array = field(repr=False, default_factory=lambda: np.empty(0))
    slopes: list[Array] = field(repr=False, default_factory=list)
    exact: bool = False


class GaussNewton:
    """Fits knobs of a problem against a floor."""

    def __init__(self, problem: Residuals, floor: NoiseFloor) -> None:
        self.problem, self.floor = problem, floor
        self.whiteners = [floor.whitener(g, problem.trials) for g in problem.groups]
        self.basis, self.shrinkage = self._patterns()
        self.means = [problem.as_counted(g, floor.mean(g, problem.trials)) for g in problem.groups]
        spread = np.array([k.spread for k in problem.knobs])
        self.precision = np.where(np.isfinite(spread), 1 / spread**2, 0.0)
        self.low = np.array([k.low for k in problem.knobs])
        self.high = np.array([k.high for k in problem.knobs])

    def _patterns(self) -> tuple[Array, Array]:
        """Orthonormal patterns of the plant's own error, and what each loses by it.

        With V = L (I + P P') L' and L⁻¹ P = U σ …, V whitens by (I − U (1 − (1 + σ²)^−½) U') L⁻¹.
        """
        known = discrepancy_of(self.problem.plant) if self.floor.learned else None
        if known is None:
            return np.empty((0, 0)), np.empty(0)
        rows = [
            self.problem.as_counted(g, known.rows(g, self.problem.trials))
            for g in self.problem.groups
        ]
        scaled = self._scaled([np.moveaxis(r, 0, -1) for r in rows])
        basis, size, _ = np.linalg.svd(_stack(scaled), full_matrices=False)
        return basis, 1 - 1 / np.sqrt(1 + size**2)

    def whitened(self, rows: list[Array]) -> list[Array]:
        """Residual spectra in noise floors, (trials, signals, K)."""
        return self.whiten([r - m for r, m in zip(rows, self.means, strict=True)])

    def whiten(self, rows: Sequence[Array]) -> list[Array]:
        """Rows (trials, signals, K, …) in noise floors."""
        scaled = self._scaled(rows)
        if not len(self.shrinkage):
            return scaled
        stacked = _stack(scaled)
        stacked -= self.basis @ (self.shrinkage[:, None] * (self.basis.T @ stacked))
        ends = np.cumsum([w[..., 0].size if w.ndim > 3 else w.size for w in scaled])[:-1]
        parts = np.split(stacked, ends)
        return [part.reshape(w.shape) for part, w in zip(parts, scaled, strict=True)]

    def _scaled(self, rows: Sequence[Array]) -> list[Array]:
        """Rows (trials, signals, K, …) in units of the floor alone."""
        return [
            np.einsum("skij,jsk...->isk...", w, r)
            for w, r in zip(self.whiteners, rows, strict=True)
        ]

    def at(self, values: Array) -> FitPoint:
        """Cost and residuals at some values."""
        rows = self.problem.residuals(values)
        squares = sum(float(np.sum(w**2)) for w in self.whitened(rows))
        cost = 0.5 * squares + 0.5 * float(self.precision @ values**2)
        return FitPoint(values, cost if np.isfinite(cost) else np.inf, rows)

    def linearise(self, point: FitPoint) -> FitPoint:
        """Add derivatives to a point: H = J'J with priors, and the gradient of the fall."""
        if not point.exact:
            _, slopes = self.problem.jacobian(point.values)
            white = [w.reshape(-1, w.shape[-1]) for w in self.whiten(slopes)]
            self._set_slopes(point, white)
            point.exact = True
        return point

    def _set_slopes(self, point: FitPoint, slopes: list[Array]) -> None:
        residual = [w.ravel() for w in self.whitened(point.rows)]
        normal = sum(s.T @ s for s in slopes) + np.diag(self.precision)
        gradient = sum(s.T @ r for s, r in zip(slopes, residual, strict=True))
        point.slopes, point.normal = slopes, np.asarray(normal)
        point.gradient = np.asarray(gradient - self.precision * point.values)

    def carry(self, start: FitPoint, end: FitPoint) -> FitPoint:
        """Derivatives at the end of a step: those at its start, put right along the step."""
        if end.exact or end is start:
            return end
        moved = end.values - start.values
        weighted = np.diag(start.normal) * moved
        along = weighted / max(float(weighted @ moved), 1e-300)
        slopes = []
        before, after = self.whitened(start.rows), self.whitened(end.rows)
        for slope, b, a in zip(start.slopes, before, after, strict=True):
            missing = (b - a).ravel() - slope @ moved
            slopes.append(slope + np.outer(missing, along))
        self._set_slopes(end, slopes)
        return end

    def step(self, point: FitPoint, free: Array) -> tuple[Array, float]:
        """Bounded step of the free knobs (zero elsewhere), and the fall of the cost it promises."""
        if not point.slopes:
            self.linearise(point)
        index = np.flatnonzero(free)
        normal = point.normal[np.ix_(index, index)]
        gradient = point.gradient[index]
        size = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        scaled = normal / np.outer(size, size) + 1e-10 * np.eye(len(index))
        root = np.linalg.cholesky(scaled).T
        right = np.linalg.solve(root.T, gradient / size)
        step = np.linalg.solve(root, right)
        low = (self.low - point.values)[index] * size
        high = (self.high - point.values)[index] * size
        if np.any(step < low) or np.any(step > high):
            low, high = np.minimum(low, 0.0) - 1e-12, np.maximum(high, 0.0) + 1e-12
            step = lsq_linear(root, right, (low, high), max_iter=60).x
        promised = float(right @ right - np.sum((root @ step - right) ** 2)) / 2
        result = np.zeros(len(point.values))
        result[index] = step / size
        return result, promised

    def fit(self, start: FitPoint, free: Array, steps: int = 12, relative: float = 0.0) -> FitPoint:
        """Lower the cost over the free knobs; never returns a higher one.

        Where secants promise less than `CONVERGED`, or than a share `relative` of the fall so far,
        or lead nowhere, the derivatives are taken anew; where exact ones do, the fit ends.
        """
        point = start
        for _ in range(steps):
            step, promised = self.step(point, free)
            better = None
            if promised >= max(CONVERGED / 2, relative * (start.cost - point.cost)):
                better = self.search(point, step)
            if better is not None:
                point = better
            elif point.exact:
                break
            else:
                self.linearise(point)
        return point

    def search(self, point: FitPoint, step: Array) -> FitPoint | None:
        """First point along a step whose cost is lower; None where there is none."""
        for share in (1.0, 0.5, 0.2, 0.05):
            values = np.clip(point.values + share * step, self.low, self.high)
            tried = self.at(values)
            if tried.cost < point.cost:
                return self.carry(point, tried)
        return None

    def covariance(self, point: FitPoint, free: Array) -> Array:
        """Covariance of the free knobs, shape (free, free)."""
        index = np.flatnonzero(free)
        normal = self.linearise(point).normal[np.ix_(index, index)]
        size = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        inverse = np.linalg.pinv(normal / np.outer(size, size), hermitian=True)
        return np.asarray(inverse / np.outer(size, size))


def _stack(rows: Sequence[Array]) -> Array:
    """Rows (trials, signals, K[, columns]) of all groups as one matrix."""
    return np.concatenate([r.reshape(-1, r.shape[3] if r.ndim > 3 else 1) for r in rows])
