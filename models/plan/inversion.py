"""Inversion of the twin: goals that lead its tip along a path, by nonlinear least squares.

The goals of each joint are a cubic B-spline that begins and ends at rest at zero. Its coefficients
c minimise the squared distance of the tip from the path and, weakly, the goals' acceleration::

    sum |tip(c) - desired|^2 + (WEIGHT * acceleration)^2

Gauss–Newton with the exact derivatives of the twin. They cost as much as twenty runs and change
little from step to step and from payload to payload, so they are renewed only where a step with the
old ones gains too little. (`scipy.optimize.least_squares` takes new ones in every step: the same
goals in three times the time.)
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from models.plan.paths import Timeline
from models.plan.tip_twin import TipTwin, TwinRun
from models.shared.kinematics import pointing_angles_rad

Array = NDArray[np.float64]
KNOT_S: Final = 0.12
"""Time between two knots: 167 coefficients a joint in 20 s. Measured on the twin of the demo with
2 kg, circle of 0.3 m in 4 s: 0.35 s leaves 7.6 mm, 0.25 s 4.8 mm, 0.18 s 2.1 mm; of 0.5 m: 0.18 s
2.5 mm, 0.12 s 0.8 mm."""
WEIGHT_M_S2: Final = 1e-5
"""Tip error that 1 rad/s² of goal acceleration outweighs [assumed]: a hundredth of a millimetre."""
MOST_STEPS: Final = 8
MOST_DERIVATIVES: Final = 4
"""Most steps, and most evaluations of the derivatives, for one payload [assumed]."""
GOOD_STEP: Final = 0.7
"""Cost after a step over that before, above which the derivatives are renewed [assumed]."""
ENOUGH: Final = 0.97
"""The same ratio above which the search ends, if the derivatives are new [assumed]."""


class Inverter:
    """Inversion of a twin along a timeline."""

    def __init__(
        self, twin: TipTwin, line: Timeline, report: Callable[[str], None] = lambda text: None
    ) -> None:
        self._twin, self._line, self._report = twin, line, report
        self._splines = GoalSplines(
            line.desired_m.shape, line.rest_rows, twin.period_s, WEIGHT_M_S2
        )
        self._slopes: Array | None = None  # those of the last payload that was inverted

    def pointing_rad(self) -> Array:
        """Goals at which the rigid link points at the desired tip, shape (n, dof)."""
        offset = self._line.desired_m[0]  # the arm stands there with its goals at zero
        lateral = np.zeros((len(self._line.desired_m), 2))
        lateral[:, : self._twin.dof] = self._line.desired_m - offset
        height = np.sqrt(np.maximum(self._twin.reach_m**2 - np.sum(lateral**2, axis=1), 1e-6))
        return pointing_angles_rad(np.column_stack([lateral, height]))[:, : self._twin.dof]

    def invert(self, payloads_kg: Sequence[float]) -> list[TwinRun]:
        """Run of the twin along the path for each payload.

        The search begins with the middle payload and goes outwards, each from the solutions for the
        payloads before it.
        """
        middle = len(payloads_kg) // 2
        solved: dict[int, Array] = {}
        for k in sorted(range(len(payloads_kg)), key=lambda k: abs(k - middle)):
            inner = k - 1 if k > middle else k + 1
            beyond = 2 * inner - k
            if inner not in solved:
                start = self._splines.fit(self.pointing_rad())
            elif beyond in solved:
                step_kg = payloads_kg[inner] - payloads_kg[beyond]
                part = (payloads_kg[k] - payloads_kg[inner]) / step_kg
                start = solved[inner] + part * (solved[inner] - solved[beyond])
            else:
                start = solved[inner]
            solved[k] = self._solve(start, payloads_kg[k], MOST_DERIVATIVES)
            self._report(f"{payloads_kg[k]:g} kg inverted")
        return [
            self._twin.run(self._splines.goals(solved[k]), m) for k, m in enumerate(payloads_kg)
        ]

    def invert_on(self, twin: TipTwin, run: TwinRun) -> TwinRun:
        """Goals for another twin of the plant, from those of a run, with the present derivatives.

        They are renewed at most once: a link that is a fifth stiffer needs no more.
        """
        other = copy.copy(self)
        other._twin = twin
        c = other._solve(self._splines.fit(run.goals_rad), run.payload_kg, 1)
        return twin.run(self._splines.goals(c), run.payload_kg)

    def _solve(self, start: Array, payload_kg: float, most_derivatives: int) -> Array:
        twin, splines = self._twin, self._splines

        def error(c: Array) -> Array:
            tip = twin.run(splines.goals(c), payload_kg).tip_m
            return np.append(tip - self._line.desired_m, splines.rough @ c)

        def slopes(c: Array) -> Array:
            by_c = twin.slopes(splines.goals(c), splines.basis, payload_kg)
            return np.concatenate([by_c.reshape(-1, len(c)), splines.rough])

        c, self._slopes = gauss_newton(error, slopes, start, most_derivatives, self._slopes)
        return c


def rms(error: Array) -> float:
    """RMS length of the rows of a table."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def gauss_newton(
    error: Callable[[Array], Array],
    slopes: Callable[[Array], Array],
    start: Array,
    most_derivatives: int,
    by_c: Array | None = None,
) -> tuple[Array, Array | None]:
    """Coefficients that minimise the sum of squared errors, and the last derivatives.

    `by_c`: derivatives of a similar problem, to begin with.
    """

    def cost_of(error: Array) -> float:
        cost = float(error @ error)
        return cost if np.isfinite(cost) else np.inf

    c, derived = start, 0
    off = error(c)
    for _ in range(MOST_STEPS):
        new = by_c is None
        if by_c is None:
            by_c, derived = slopes(c), derived + 1
        normal = by_c.T @ by_c
        normal[np.diag_indices_from(normal)] += 1e-12 * np.trace(normal)
        step = np.linalg.solve(normal, -by_c.T @ off)
        ratio = np.inf
        for part in (1.0, 0.5, 0.25, 0.1) if new else (1.0,):
            tried = error(c + part * step)
            if cost_of(tried) < cost_of(off):
                ratio = cost_of(tried) / cost_of(off)
                c, off = c + part * step, tried
                break
        if ratio > ENOUGH and (new or derived >= most_derivatives):
            break
        if ratio > GOOD_STEP and derived < most_derivatives:
            by_c = None
    return c, by_c


class GoalSplines:
    """Cubic B-splines of goals of a shape (n, dof) that begin at rest.

    `weight_m_s2`: tip error that an acceleration of 1 rad/s² outweighs.
    """

    def __init__(
        self, shape: tuple[int, ...], rest_rows: int, period_s: float, weight_m_s2: float
    ) -> None:
        rows, self._dof = shape
        begin_s, end_s = rest_rows * period_s, (rows - 1) * period_s
        count = max(4, round((end_s - begin_s) / KNOT_S)) - 3
        knots = begin_s + (end_s - begin_s) / (count + 3) * np.arange(count + 4)
        at_s = np.arange(rows) * period_s
        self.basis, second = np.zeros((rows, count)), np.zeros((rows, count))
        for k in range(count):
            spline = BSpline.basis_element(knots[k : k + 5], extrapolate=False)
            self.basis[:, k] = np.nan_to_num(spline(at_s))
            second[:, k] = np.nan_to_num(spline.derivative(2)(at_s))
        # As long as the accelerations of all rows, with as many rows as coefficients
        self.rough = weight_m_s2 * np.kron(np.eye(self._dof), np.linalg.qr(second, mode="r"))

    def goals(self, c: Array) -> Array:
        """Goals of coefficients, joint after joint, shape (n, dof)."""
        return np.asarray(self.basis @ c.reshape(self._dof, -1).T)

    def fit(self, goals_rad: Array) -> Array:
        """Coefficients whose goals are nearest to goals of shape (n, dof)."""
        return np.asarray(np.linalg.lstsq(self.basis, goals_rad, rcond=None)[0].T.ravel())
