"""Stiffness of a link relative to its plant: from a probing motion, and from the current of a plan.

In slow motion a stiffer link and a lighter payload need the same current. Near the first mode of
the link they do not: the mode's frequency determines their ratio, and the magnitude of the currents
the payload. So a **probing motion** (`ProbeDesign`) precedes a plan. Its goals are the same for
every payload. Planning has reduced the currents of the whole motion to a few linear features z, and
has computed their expectation over a grid of relative stiffness k and payload m. The features are
whitened: their noise, including friction and the other uncertain parameters of the plant, is
uncorrelated with standard deviation 1. `ProbeEstimate` minimises::

    |z - expected(k, m)|^2 + (k / PROBE_PRIOR_DEVIATION)^2  [+ ((m - known) / KNOWN)^2]

It starts at the best node of the grid and takes Gauss–Newton steps on the quadratic through the
nodes around it.

At a known payload the current **along the plan** shows the stiffness as well: a stiffer link bends
less, and its current differs from the plan's by a curve that planning has computed
(`StiffnessSlopes`). Recursive least squares (`StiffnessEstimate`) estimate the relative stiffness
together with a deviation of friction and a constant current of each joint [Ljung, *System
Identification* (1999), section 11.2].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

Columns = tuple[tuple[float, ...], ...]
MOST_ROWS: Final = 2_000
MOST_FEATURES: Final = 40
MOST_NODES: Final = 200
"""Largest probing motion that is read: rows, features, nodes of an axis [assumed]."""
MOST_VALUE: Final = 1e6


class ProbeDesign(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Probing motion that precedes the first run of a plan."""

    # Goals relative to the plan's first row, one column per joint, beginning and ending at zero
    goals_rad: Columns
    # Weights of the currents in 1/A: for each feature a column per joint, one value per row
    weights: tuple[Columns, ...]
    stiffness: tuple[
        float, ...
    ]  # Grid of relative stiffness, 0 for the plant's, in equal rising steps
    payloads_kg: tuple[float, ...]  # Grid of payloads, in equal rising steps
    expected: tuple[
        tuple[tuple[float, ...], ...], ...
    ]  # Expected features by stiffness and payload

    @property
    def rows(self) -> int:
        return len(self.goals_rad[0])


def wrong_in_probe(probe: ProbeDesign | None, dof: int) -> str:
    """Return the first error in a probing motion, as a sentence; empty for none."""
    if probe is None:
        return ""
    rows = len(probe.goals_rad[0]) if probe.goals_rad else 0
    tables = probe.goals_rad, *probe.weights
    if not 2 <= rows <= MOST_ROWS or not 1 <= len(probe.weights) <= MOST_FEATURES:
        return f"has a probe of {rows} rows and {len(probe.weights)} features"
    if any(len(t) != dof or any(len(c) != rows for c in t) for t in tables):
        return f"needs {dof} columns of {rows} rows in its probe"
    sizes = len(probe.stiffness), len(probe.payloads_kg)
    if not all(3 <= size <= MOST_NODES for size in sizes):
        return f"has a probe with a grid of {sizes[0]} times {sizes[1]} nodes"
    for axis in (probe.stiffness, probe.payloads_kg):
        steps = np.diff(axis)
        if not (steps[0] > 1e-3 and np.allclose(steps, steps[0])):
            return "has a probe whose grid does not rise in equal steps"
    if probe.stiffness[0] <= -1.0 or probe.payloads_kg[0] < 0.0:
        return "has a probe with a link without stiffness or a negative payload"
    if len(probe.expected) != sizes[0] or any(
        len(row) != sizes[1] or any(len(f) != len(probe.weights) for f in row)
        for row in probe.expected
    ):
        return "has a probe whose expected features do not fit its grid"
    values = (*tables, probe.stiffness, probe.payloads_kg, probe.expected)
    if not all(np.all(np.abs(np.array(v)) <= MOST_VALUE) for v in values):
        return f"has a value in its probe that is not finite or beyond {MOST_VALUE:g}"
    if any(abs(column[k]) > 1e-9 for column in probe.goals_rad for k in (0, -1)):
        return "has a probe that does not begin and end at zero"
    return ""


Array = NDArray[np.float64]
PROBE_PRIOR_DEVIATION: Final = 0.15
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


class ProbeResult(NamedTuple):
    stiffness: float  # Relative stiffness, 0 for the plant's
    payload_kg: float
    deviation: float  # Standard deviation of the stiffness
    misfit: float  # Mean square residual of the features per degree of freedom

    @property
    def certain(self) -> bool:
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
        self._result: ProbeResult | None = None
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
            self._result = self._sought()

    def result(self) -> ProbeResult | None:
        """Return the estimate; None if too many rows are missing or it is not finite."""
        return self._result if self._next >= self.rows else self._sought()

    def _sought(self) -> ProbeResult | None:
        missing = self._missing + self.rows - min(self._next, self.rows)
        return None if missing > MOST_MISSING else self._fitted()

    def _fitted(self) -> ProbeResult | None:
        k, m = self._nearest_node()
        known, deviation = self._known_kg, KNOWN_DEVIATION_KG
        prior = np.array([0.0, m if known is None else known])
        weight = np.array([PROBE_PRIOR_DEVIATION**-2, 0.0 if known is None else deviation**-2])
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
        return ProbeResult(float(at[0]), float(at[1]), deviation, misfit)

    @property
    def _steps(self) -> Array:
        return np.array([self._stiffness[1] - self._stiffness[0],
                         self._payloads_kg[1] - self._payloads_kg[0]])  # fmt: skip

    def _nearest_node(self) -> tuple[float, float]:
        cost = np.sum((self._expected - self._features) ** 2, axis=2)
        cost = cost + (self._stiffness[:, None] / PROBE_PRIOR_DEVIATION) ** 2
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


CURRENT_DEVIATION_A: Final = 0.25
"""Standard deviation of a sample of the current. Measured on the rig: 0.055 A around the best fit
with a correlation of 0.9 from sample to sample, which counts as 0.24 A of white noise."""
PRIOR_DEVIATION: Final = 0.1
"""Standard deviation of the relative stiffness before a run [assumed: pressure, temperature]."""
FRICTION_DEVIATION: Final = 0.3
"""Standard deviation of the relative friction; plans on the rig show 0.15 to 0.25."""
BIAS_DEVIATION_A: Final = 0.05
"""Standard deviation of the constant current; a payload 3 mm off the axis causes 0.01 A."""
MOST: Final = 0.3
"""Bound on the magnitude of the relative stiffness that corrects the goals [assumed]."""


class StiffnessEstimate:
    """Recursive least squares of relative stiffness, friction and constant current."""

    def __init__(self, dof: int) -> None:
        self._dof = dof
        deviations = [PRIOR_DEVIATION, *[FRICTION_DEVIATION] * dof, *[BIAS_DEVIATION_A] * dof]
        self._theta = [0.0] * len(deviations)
        # Lists, because NumPy takes three times as long for five values.
        self._covariance = [
            [d * d if i == k else 0.0 for k in range(len(deviations))]
            for i, d in enumerate(deviations)
        ]
        self.value = 0.0

    def update(
        self, excess_a: Sequence[float], by_stiffness: Sequence[float],
        by_friction: Sequence[float], weight: Sequence[float],
    ) -> None:  # fmt: skip
        """Update with the currents of one fresh sample.

        `excess_a`: measured currents minus those of a link as stiff as the plant.
        """
        theta, covariance, dof = self._theta, self._covariance, self._dof
        for j in range(dof):
            w, innovation = weight[j], excess_a[j]
            if w <= 0.0 or not math.isfinite(innovation):
                continue
            a, b = by_stiffness[j], by_friction[j]  # regressors 0 and f; that of c is 1
            f, c = 1 + j, 1 + dof + j
            gain = [a * row[0] + b * row[f] + row[c] for row in covariance]
            variance = CURRENT_DEVIATION_A**2 + w * (a * gain[0] + b * gain[f] + gain[c])
            innovation -= a * theta[0] + b * theta[f] + theta[c]
            limit, share = 3.0 * math.sqrt(variance), w / variance
            step = share * min(max(innovation, -limit), limit)
            for i, g in enumerate(gain):
                theta[i] += step * g
                scaled = share * g
                covariance[i] = [p - scaled * h for p, h in zip(covariance[i], gain, strict=True)]
        self.value = min(max(theta[0], -MOST), MOST)
