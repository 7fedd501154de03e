"""Stiffness and payload of a link from the currents of a probing motion.

In slow motion a stiffer link and a lighter payload need the same current. Near the first mode of
the link they do not: the mode's frequency determines their ratio, and the magnitude of the currents
the payload. The estimate minimises, over stiffness k and payload m, with the features z of the
currents (`ProbeDesign`)::

    |z - expected(k, m)|^2 + (k / PRIOR)^2  [+ ((m - known) / KNOWN)^2]

It starts at the best node of the grid and takes Gauss–Newton steps on the quadratic through the
nodes around it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.goals.probe_design import ProbeDesign

__all__ = ["ProbeEstimate", "ProbeFinding"]

Array = NDArray[np.float64]
PRIOR_DEVIATION: Final = 0.15
"""Standard deviation of the relative stiffness before the motion [assumed]."""
KNOWN_DEVIATION_KG: Final = 0.02
"""Standard deviation of a known payload [assumed]."""
CERTAIN: Final = 0.1
"""Largest standard deviation of an accepted relative stiffness. On rigs with 0.85 to 1.25 times the
stiffness, 0.4 and 1.3 kg: 0.02 to 0.04 with a known payload, else 0.04 to 0.08."""
MOST_MISFIT: Final = 4.0
"""Largest mean square residual of the features per degree of freedom, of an accepted estimate. It
is 0.1 to 0.6 on these rigs, whose noise is lower than the plan assumes."""
MOST_MISSING: Final = 2
"""Most rows without a fresh sample; the latest current is held in them."""
STEPS: Final = 6
ENOUGH: Final = 1e-4
"""Most Gauss–Newton steps, and the change of stiffness and payload at which they end."""


class ProbeFinding(NamedTuple):
    """Result of a probing motion."""

    stiffness: float  # Relative stiffness, 0 for the plant's
    payload_kg: float
    deviation: float  # Standard deviation of the stiffness
    misfit: float  # Mean square residual of the features per degree of freedom

    @property
    def certain(self) -> bool:
        """Whether the estimate is accepted."""
        return self.deviation <= CERTAIN and self.misfit <= MOST_MISFIT


class ProbeEstimate:
    """Estimate from the features of the currents, which are accumulated row by row."""

    def __init__(self, design: ProbeDesign, known_kg: float | None) -> None:
        self.rows, self._known_kg = design.rows, known_kg
        self._weights = np.ascontiguousarray(np.moveaxis(np.array(design.weights), 2, 0))
        self._stiffness, self._payloads_kg = (
            np.array(design.stiffness),
            np.array(design.payloads_kg),
        )
        self._expected = np.array(design.expected)
        self._features = np.zeros(len(design.weights))
        self._current_a = np.zeros(len(design.goals_rad))
        self._next, self._missing = 0, 0
        self._found: ProbeFinding | None = None
        self._fitted()  # warm-up: a first call in a tick took 12 ms

    def take(self, row: int, fresh: bool, current_a: Array) -> None:
        """Add the currents of a row, shape (dof,); skipped rows count as missing.

        Rows before the first, which are negative, are ignored.
        """
        fresh = fresh and bool(np.isfinite(current_a).all())
        for k in range(max(self._next, 0), min(row + 1, self.rows)):
            if k < row or not fresh:
                self._missing += 1
            else:
                self._current_a[:] = current_a
            self._features += self._weights[k] @ self._current_a
        self._next = max(self._next, row + 1)
        if row == self.rows - 1:  # the next tick restarts the observer
            self._found = self._sought()

    def found(self) -> ProbeFinding | None:
        """Return the estimate; None if too many rows are missing or it is not finite."""
        return self._found if self._next >= self.rows else self._sought()

    def _sought(self) -> ProbeFinding | None:
        missing = self._missing + self.rows - min(self._next, self.rows)
        return None if missing > MOST_MISSING else self._fitted()

    def _fitted(self) -> ProbeFinding | None:
        k, m = self._nearest_node()
        known, deviation = self._known_kg, KNOWN_DEVIATION_KG
        prior = np.array([0.0, m if known is None else known])
        weight = np.array([PRIOR_DEVIATION**-2, 0.0 if known is None else deviation**-2])
        at, steps = np.array([k, m]), self._steps
        for _ in range(STEPS):
            left, slopes = self._left(at)
            step = _inverse(slopes, weight) @ (slopes.T @ left + weight * (prior - at))
            before, at = at, self._inside(at + np.minimum(np.maximum(step, -steps), steps))
            if np.all(np.abs(at - before) < ENOUGH):
                break
        left, slopes = self._left(at)
        variance = float(_inverse(slopes, weight)[0, 0])
        misfit = float(left @ left) / max(len(left) - 2, 1)
        if not (math.isfinite(variance) and math.isfinite(misfit)):
            return None
        deviation = math.sqrt(max(variance, 0.0) * max(misfit, 1.0))
        return ProbeFinding(float(at[0]), float(at[1]), deviation, misfit)

    @property
    def _steps(self) -> Array:
        return np.array([self._stiffness[1] - self._stiffness[0],
                         self._payloads_kg[1] - self._payloads_kg[0]])  # fmt: skip

    def _nearest_node(self) -> tuple[float, float]:
        cost = np.sum((self._expected - self._features) ** 2, axis=2)
        cost = cost + (self._stiffness[:, None] / PRIOR_DEVIATION) ** 2
        if self._known_kg is not None:  # a node need not lie at the known payload
            cost = cost + ((self._payloads_kg - self._known_kg) / self._steps[1]) ** 2
        i, j = np.unravel_index(int(np.argmin(cost)), cost.shape)
        return float(self._stiffness[i]), float(self._payloads_kg[j])

    def _inside(self, at: Array) -> Array:
        ends = zip(self._stiffness[[0, -1]], self._payloads_kg[[0, -1]], strict=True)
        low, high = (np.array(end) for end in ends)
        return np.asarray(np.minimum(np.maximum(at, low), high))

    def _left(self, at: Array) -> tuple[Array, Array]:
        """Return the residual of the features at (k, m), and the slopes of their expectation."""
        hk, hm = self._steps.tolist()
        axes = self._stiffness, self._payloads_kg
        i, j = (
            min(max(round(float((x - axis[0]) / h)), 1), len(axis) - 2)
            for x, axis, h in zip(at, axes, (hk, hm), strict=True)
        )
        p, a, b = self._expected, at[0] - axes[0][i], at[1] - axes[1][j]
        middle, more, less = p[i, j], p[i + 1, j], p[i - 1, j]
        heavy, light = p[i, j + 1], p[i, j - 1]
        by_k, by_m = (more - less) / (2 * hk), (heavy - light) / (2 * hm)
        kk, mm = (more - 2 * middle + less) / hk**2, (heavy - 2 * middle + light) / hm**2
        km = (p[i + 1, j + 1] - p[i + 1, j - 1] - p[i - 1, j + 1] + p[i - 1, j - 1]) / (4 * hk * hm)
        expected = middle + a * (by_k + 0.5 * a * kk + b * km) + b * (by_m + 0.5 * b * mm)
        slopes = np.column_stack([by_k + a * kk + b * km, by_m + b * mm + a * km])
        return self._features - expected, slopes


def _inverse(slopes: Array, weight: Array) -> Array:
    """Invert the 2 × 2 normal matrix; NumPy's inverse takes ten times as long."""
    (a, b), (_, c) = (slopes.T @ slopes).tolist()
    a, c = a + float(weight[0]) + 1e-9, c + float(weight[1]) + 1e-9
    return np.asarray(np.array([[c, -b], [-b, a]]) / (a * c - b * b))
