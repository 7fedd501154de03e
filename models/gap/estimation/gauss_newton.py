"""Generalised least squares over the fit parameters, in units of the noise floor.

The cost of values θ is ½ |W (r(θ) − m)|² + ½ θ' P θ: W whitens by the floor, m is the known mean
of the plant's own error, P is the prior of nuisance and of the variation between trials
(`models.plant.identification.trial_variation`). Steps stay within the bounds and are taken only
where the cost falls. Exact derivatives cost twenty simulations, so between them they are updated by
secants (Broyden 1965).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.transfer import Knowledge
from models.gap.residuals.residuals import Residuals
from models.plant.identification.trial_variation import prior_rows
from models.plant.step_model import Array

FIT_STEPS: Final = 12
"""Most steps of a fit while the noise floor is measured [assumed]."""
CONVERGED_FALL: Final = 0.3
"""Predicted fall of twice the cost below which a fit stops [assumed]."""
LINE_SEARCH: Final = (1.0, 0.5, 0.2, 0.05)
"""Fractions of a step that are tried in turn [assumed]."""
NUISANCE_FIT_STEPS: Final = 20
"""Most steps of the nuisance fit, and of the fit after an inclusion [assumed]."""
RIDGE: Final = 1e-10
"""Ridge of a scaled normal equation: keeps it regular [assumed]."""
RELATIVE_FALL: Final = 1e-3
"""Relative fall of the cost below which these fits compute exact derivatives [assumed]."""


Mask = NDArray[np.bool_]
"""Choice among all fit parameters, (p,)."""


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


@dataclass
class FitPoint:
    """Values of all fit parameters, with the residual there."""

    values: Array  # (p,)
    cost: float  # See the module's docstring
    rows: list[Array]  # Residual spectra, as `Residuals.residuals`
    # J'J with priors, the gradient of the fall, and the whitened derivatives by group; empty before
    # `GaussNewton.linearise`
    normal: Array = field(repr=False, default_factory=lambda: np.empty(0))
    gradient: Array = field(repr=False, default_factory=lambda: np.empty(0))
    slopes: list[Array] = field(repr=False, default_factory=list)
    derived: Mask = field(
        repr=False, default_factory=lambda: np.zeros(0, dtype=np.bool_)
    )  # (p,), fit parameters whose derivatives are known; those of the others are zero
    exact: bool = False  # Whether the derivatives are exact; secants otherwise
    # Start of the step to this point, until the derivatives here are needed
    origin: FitPoint | None = field(repr=False, default=None)

    def has_derivatives(self, wanted: Mask) -> bool:
        """Whether derivatives by these fit parameters are known here or at the origin."""
        known = bool(self.slopes) or self.origin is not None
        return known and bool(self.derived[np.flatnonzero(wanted)].all())


class GaussNewton:
    """Fit of residuals against a noise floor."""

    def __init__(self, residuals: Residuals, floor: NoiseFloor) -> None:
        self.residuals, self.floor = residuals, floor
        trials, groups = residuals.trials, residuals.groups
        self.whiteners = [floor.whitener(g, trials) for g in groups]
        self.means = [residuals.as_counted(g, floor.mean(g, trials)) for g in groups]
        prior = prior_rows(residuals.fit_parameters)
        self.prior = prior.T @ prior
        self.low = np.array([q.low for q in residuals.fit_parameters])
        self.high = np.array([q.high for q in residuals.fit_parameters])

    def start(self) -> FitPoint:
        """The diagnosed plant: every fit parameter is zero."""
        point = self.at(np.zeros(len(self.residuals.fit_parameters)))
        if np.isfinite(point.cost):
            return point
        raise self.residuals.instability(point.rows)

    def knowledge(self) -> dict[str, Knowledge]:
        """What is known of the plant's mean error, by key of the group."""
        trials = self.residuals.trials
        return {g.key: self.floor.curves_for(g, trials)[1] for g in self.residuals.groups}

    def whitened(self, rows: list[Array]) -> list[Array]:
        """Residual spectra in noise floors, (trials, signals, K)."""
        return self.whiten([r - m for r, m in zip(rows, self.means, strict=True)])

    def mean_square(self, point: FitPoint) -> float:
        """Mean squared residual of a point, in noise floors."""
        return mean_square(self.whitened(point.rows))

    def whiten(self, rows: Sequence[Array]) -> list[Array]:
        """Rows (trials, signals, K, …) in noise floors."""
        return [
            np.einsum("skij,jsk...->isk...", w, r)
            for w, r in zip(self.whiteners, rows, strict=True)
        ]

    def at(self, values: Array) -> FitPoint:
        """Cost and residuals at some values."""
        rows = self.residuals.residuals(values)
        cost = 0.5 * (sum_of_squares(self.whitened(rows)) + float(values @ self.prior @ values))
        return FitPoint(values, cost if np.isfinite(cost) else np.inf, rows)

    def linearise(self, point: FitPoint, wanted: Mask | None = None) -> FitPoint:
        """Add derivatives to a point: H = J'J with priors, and the gradient of the fall.

        `wanted`, shape (p,): fit parameters to differentiate by; by default all. Fewer are faster.
        """
        wanted = np.ones(len(point.values), dtype=np.bool_) if wanted is None else wanted
        if not (point.exact and point.has_derivatives(wanted)):
            derived = np.asarray(wanted, dtype=np.bool_)
            slopes = self.residuals.jacobian(point.values, derived)
            white = []
            for whitened in self.whiten(slopes):
                rows = np.zeros((math.prod(whitened.shape[:-1]), len(derived)))
                rows[:, derived] = whitened.reshape(len(rows), int(derived.sum()))
                white.append(rows)
            self._set_slopes(point, white)
            point.derived, point.exact, point.origin = derived, True, None
        return point

    def _set_slopes(
        self, point: FitPoint, slopes: list[Array], normal: Array | None = None
    ) -> None:
        residual = [w.ravel() for w in self.whitened(point.rows)]
        if normal is None:
            normal = np.asarray(sum(s.T @ s for s in slopes) + self.prior)
        gradient = sum(s.T @ r for s, r in zip(slopes, residual, strict=True))
        point.slopes, point.normal = slopes, normal
        point.gradient = np.asarray(gradient - self.prior @ point.values)

    def carry(self, start: FitPoint, end: FitPoint) -> FitPoint:
        """Give the end of a step the derivatives at its start, corrected along the step.

        The search tries far more points than it continues from, so they are computed only when a
        step from the end needs them.
        """
        if not (end.exact or end is start):
            self._correct(start)
            end.origin, end.derived = replace(start), start.derived  # the start may get exact ones
        return end

    def _correct(self, end: FitPoint) -> None:
        """Compute the derivatives of a point from those of its origin, if it has one."""
        if end.origin is None:
            return
        start, end.origin = end.origin, None
        moved = end.values - start.values
        weighted = np.diag(start.normal) * moved
        along = weighted / max(float(weighted @ moved), 1e-300)
        slopes, across, square = [], np.zeros(len(moved)), 0.0
        before, after = self.whitened(start.rows), self.whitened(end.rows)
        for slope, b, a in zip(start.slopes, before, after, strict=True):
            missing = (b - a).ravel() - slope @ moved
            across, square = across + slope.T @ missing, square + float(missing @ missing)
            slopes.append(slope + np.outer(missing, along))
        update = np.outer(across, along)  # of J'J: a tenth of the time of a new product
        update = update + update.T + square * np.outer(along, along)
        self._set_slopes(end, slopes, start.normal + update)

    def step(self, point: FitPoint, free: Mask) -> tuple[Array, float]:
        """Bounded step of the free fit parameters (others zero), and the fall of cost it predicts.

        Shapes: `free` (p,).
        """
        if not point.has_derivatives(free):
            self.linearise(point, free)
        self._correct(point)
        index = np.flatnonzero(free)
        equation = NormalEquation.of(point.normal, index)
        size = equation.size
        root = np.linalg.cholesky(equation.regular(RIDGE)).T
        right = np.linalg.solve(root.T, point.gradient[index] / size)
        step = np.linalg.solve(root, right)
        low = (self.low - point.values)[index] * size
        high = (self.high - point.values)[index] * size
        if np.any(step < low) or np.any(step > high):
            low, high = np.minimum(low, 0.0) - 1e-12, np.maximum(high, 0.0) + 1e-12
            step = lsq_linear(root, right, (low, high), max_iter=60).x
        predicted = float(right @ right - np.sum((root @ step - right) ** 2)) / 2
        result = np.zeros(len(point.values))
        result[index] = step / size
        return result, predicted

    def fit(
        self, start: FitPoint, free: Mask, most_steps: int | None = None, relative: float = 0.0
    ) -> FitPoint:
        """Lower the cost over the free fit parameters; never returns a higher one.

        The derivatives are computed exactly again if secants predict less than
        `CONVERGED_FALL`, or than a fraction `relative` of the fall so far, or do
        not lower the cost. If exact ones do not either, the fit ends.

        Shapes: `free` (p,).
        """
        point = start
        for _ in range(FIT_STEPS if most_steps is None else most_steps):
            step, predicted = self.step(point, free)
            better = None
            least = CONVERGED_FALL / 2
            if predicted >= max(least, relative * (start.cost - point.cost)):
                better = self.line_search(point, step)
            if better is not None:
                point = better
            elif point.exact:
                break
            else:
                self.linearise(point, free)
        return point

    def fit_nuisance(self, start: FitPoint, relative: float = 0.0) -> FitPoint:
        """Fit of nuisance and variation between trials, without any effect.

        The nuisance goes first: together they start along the valley in which the variation of
        every trial compensates for a change of the link, and stop there. Measured on a link with 18
        % less stiffness: residual 18.6 noise floors together, 2.7 in this order.
        """
        kinds = np.array([q.kind for q in self.residuals.fit_parameters])
        steps = NUISANCE_FIT_STEPS
        point = self.fit(start, kinds == "nuisance", steps, relative)
        return self.fit(point, kinds != "effect", steps, relative)

    def line_search(self, point: FitPoint, step: Array) -> FitPoint | None:
        """First point along a step with a lower cost; None if there is none.

        Shapes: `step` (p,).
        """
        for fraction in LINE_SEARCH:
            values = np.clip(point.values + fraction * step, self.low, self.high)
            tried = self.at(values)
            if tried.cost < point.cost:
                return self.carry(point, tried)
        return None

    def covariance(self, point: FitPoint, free: Mask) -> Array:
        """Covariance of the free fit parameters, shape (free, free).

        Shapes: `free` (p,).
        """
        return NormalEquation.of(self.linearise(point, free).normal, np.flatnonzero(free)).inverse()
