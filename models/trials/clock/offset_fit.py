"""Fit of the offset between two clocks in continuous time, without the lag of the link's bend.

The direction c of the first marker row is the joint's angle q plus the bend below that row, and the
bend lags. With the bend s between the first two rows,

    c(t) - κ s(t) = a + g q(t - offset),

where κ is estimated from the recording, with the nominal link as prior (`bending_lag`). a and g
absorb what is in phase with the motion: offsets of the encoder and of the frame. The noise of the
markers, which would lower κ (errors in variables), is estimated from second differences.
"""

from __future__ import annotations

from copy import copy
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from models.trials.clock.bending_lag import RATIO_DEVIATION, BendRatio
from models.trials.clock.offset_search import ClockSignal
from models.trials.trial import Array

GAIN_DEVIATION: Final = 0.01
"""Standard deviation of g: the frame's origin is known to 3 mm at a row 0.3 m away [assumed]."""
LAG_DEVIATION: Final = 0.06
"""Standard deviation of the correction, relative to it, on the rig's structures default, test_a
and test_b at 0 to 2 kg."""
UNCORRECTED_DEVIATION_S: Final = 0.004
"""The same without measured bend: the lag is 1 to 9 ms on the rig at 0 to 2 kg."""
FLOOR_S: Final = 1e-4
"""Standard deviation of the remaining errors without bend: encoder steps, play of the gear."""
RANGE_S: Final = 0.03
"""Half width of the search around the coarse offset."""
MODEL_ERROR_S: Final = 0.25
"""Correlation time of model errors: the period of the fastest motion, 4 Hz."""
BLOCK_S: Final = 1.0
"""Time over which residuals count as dependent."""


LEAST_SAMPLES: Final = 100
"""Fewest samples of half of the motion for an offset of its own."""


class ClockDrift(NamedTuple):
    """Change of the offset from the first half of the motion to the second, or over sync edges."""

    # Offset of the second half minus that of the first, or at the last edge minus at the first
    change_s: float
    deviation_s: float  # Standard deviation of the change
    over_s: float  # Time between the middles of the halves, or between those edges


class OffsetFit(NamedTuple):
    """Fitted offset between two clocks, with error and residuals."""

    offset_s: float  # Add it to the servo's times
    error_s: float  # Half width of the 95 % interval of the offset
    lag_s: float  # Lag of the bend, removed from the offset
    correlation: float  # Correlation of angle and direction at the offset
    # Direction without bend minus angle, about its mean, at every compared sample; (n, dof), rad
    residual: Array
    time_s: Array  # Times of these samples on the motion capture's clock, (n,)
    drift: ClockDrift | None = None  # None if half of the motion has too few samples


def fit_offset(
    angle: ClockSignal,
    seen: ClockSignal,
    bend: Array | None,
    ratio: BendRatio,
    start_s: float,
) -> OffsetFit:
    """Fit the offset near `start_s`.

    `seen` is the direction of the first row on the motion capture's clock. `bend` (n, dof) is the
    turn from the first row to the second at the same samples; None if it was not measured, or if
    the direction is that of the base, which does not bend. `ratio` is the nominal link's, and
    `BendRatio(0, 0)` for the base.
    """
    near = _Comparison(angle, seen, bend, start_s)
    raw_s = offset_s = near.best(0.0)
    if bend is not None:
        for _ in range(2):
            kappa = near.bend_ratio(offset_s, ratio)
            offset_s = near.best(kappa * ratio.late / ratio.whole)
        kappa = kappa * ratio.late / ratio.whole
    else:
        kappa = np.zeros(angle.values.shape[1])
    residual, rate, kept, correlation = near.at(offset_s, kappa)
    deviation_s = _standard_error_s(near.seen_s[kept], residual, rate)
    if bend is not None:
        deviation_s = np.hypot(deviation_s, LAG_DEVIATION * (raw_s - offset_s))
    elif ratio.whole > 0:
        deviation_s = np.hypot(deviation_s, UNCORRECTED_DEVIATION_S)
    return OffsetFit(
        offset_s,
        float(1.96 * np.hypot(deviation_s, FLOOR_S)),
        raw_s - offset_s,
        correlation,
        residual,
        near.seen_s[kept],
        _drift(near, offset_s, kappa),
    )


def _drift(near: _Comparison, offset_s: float, kappa: Array | float) -> ClockDrift | None:
    """Drift between two halves of the motion with equal information on the offset."""
    _, rate, kept, _ = near.at(offset_s, kappa)
    weight, time_s = np.sum(rate**2, axis=1), near.seen_s[kept]
    if len(time_s) < 2 * LEAST_SAMPLES or not weight.sum() > 0:
        return None
    told = np.cumsum(weight)
    split = int(np.searchsorted(told, told[-1] / 2))
    offsets, deviations, middles = [], [], []
    for half in (slice(None, split), slice(split, None)):
        if len(time_s[half]) < LEAST_SAMPLES:
            return None
        part = near.within(time_s[half][0], time_s[half][-1])
        offsets.append(part.best(kappa))
        residual, rate, kept, _ = part.at(offsets[-1], kappa)
        deviations.append(_standard_error_s(part.seen_s[kept], residual, rate))
        middles.append(float(np.average(time_s[half], weights=weight[half])))
    deviation_s = float(np.linalg.norm([*deviations, FLOOR_S]))
    return ClockDrift(offsets[1] - offsets[0], deviation_s, middles[1] - middles[0])


class _Comparison:
    """Comparison of servo and link at offsets near a first one."""

    def __init__(
        self, angle: ClockSignal, seen: ClockSignal, bend: Array | None, start_s: float
    ) -> None:
        self.start_s, self._angle_s = start_s, angle.time_s
        self._spline = CubicSpline(angle.time_s, angle.values)
        self._gap_s = 3 * np.median(np.diff(angle.time_s))
        shifted = seen.time_s - start_s
        inside = (shifted >= angle.time_s[0] + RANGE_S) & (shifted <= angle.time_s[-1] - RANGE_S)
        after = np.clip(np.searchsorted(angle.time_s, shifted), 1, len(angle.time_s) - 1)
        inside &= angle.time_s[after] - angle.time_s[after - 1] <= self._gap_s
        self.seen_s, self._seen = seen.time_s[inside], seen.values[inside]
        self._bend = np.zeros_like(self._seen) if bend is None else bend[inside]

    def within(self, first_s: float, last_s: float) -> _Comparison:
        """Comparison restricted to the samples between two times."""
        part, inside = copy(self), (self.seen_s >= first_s) & (self.seen_s <= last_s)
        part.seen_s, part._seen, part._bend = (
            v[inside] for v in (self.seen_s, self._seen, self._bend)
        )
        return part

    def best(self, kappa: Array | float) -> float:
        """Offset with the least sum of squares, for given ratios."""
        found = minimize_scalar(
            lambda offset_s: float(np.sum(self.at(offset_s, kappa)[0] ** 2)),
            bounds=(self.start_s - RANGE_S, self.start_s + RANGE_S),
            method="bounded",
            options={"xatol": 1e-6},
        )
        return float(found.x)

    def at(self, offset_s: float, kappa: Array | float) -> tuple[Array, Array, Array, float]:
        """Residual, rate of the angle, kept samples and correlation at an offset."""
        q = self._spline(self.seen_s - offset_s)
        y = self._seen - kappa * self._bend
        kept = np.all(np.isfinite(y), axis=1)
        q, y = q[kept] - q[kept].mean(axis=0), y[kept] - y[kept].mean(axis=0)
        power, shared = np.sum(q * q, axis=0), np.sum(q * y, axis=0)
        gain = shared / np.maximum(power, 1e-30)
        size = np.sqrt(power.sum() * np.sum(y * y))
        rate = gain * self._spline(self.seen_s[kept] - offset_s, 1)
        return y - gain * q, rate, kept, float(shared.sum() / size) if size > 0 else 0.0

    def bend_ratio(self, offset_s: float, ratio: BendRatio) -> Array:
        """Ratio of each joint, shape (dof,), from the bend in phase with the motion.

        A term in the rate absorbs what is out of phase: an error of the offset, and the lag itself.
        """
        q = self._spline(self.seen_s - offset_s)
        kept = np.all(np.isfinite(self._seen + self._bend), axis=1)
        below, bend, q = (self._seen - q)[kept], self._bend[kept], q[kept]
        rates = self._spline(self.seen_s[kept] - offset_s, 1)
        noise_bend = _second_difference(bend, bend)
        noise_shared = _second_difference(below, bend)
        # The model error, a tenth of the bend, is correlated over a quarter of a second.
        alike = max(MODEL_ERROR_S / float(np.median(np.diff(self.seen_s))), 1.0)
        variance = alike * np.maximum(np.var(below, axis=0) * 1e-2, 1e-8)
        ratios = []
        for j in range(q.shape[1]):
            x, s, r, y = (v[:, j] - v[:, j].mean() for v in (q, bend, rates, below))
            design = np.column_stack([x, s, r])
            matrix, right = design.T @ design, design.T @ y
            matrix[1, 1] -= len(x) * noise_bend[j]
            right[1] -= len(x) * noise_shared[j]
            matrix = matrix / variance[j] + np.diag([GAIN_DEVIATION**-2, RATIO_DEVIATION**-2, 1e-9])
            right = right / variance[j] + np.array([0.0, ratio.whole * RATIO_DEVIATION**-2, 0.0])
            ratios.append(np.linalg.solve(matrix, right)[1])
        low, high = ratio.whole - 3 * RATIO_DEVIATION, ratio.whole + 3 * RATIO_DEVIATION
        return np.asarray(np.clip(ratios, max(low, 0.0), high))


def _second_difference(a: Array, b: Array) -> Array:
    """Covariance of the white noise of two signals, per column."""
    return np.asarray(np.mean(np.diff(a, 2, axis=0) * np.diff(b, 2, axis=0), axis=0) / 6.0)


def _standard_error_s(time_s: Array, residual: Array, rate: Array) -> float:
    """Standard error of the offset, allowing for correlated residuals within a block."""
    block = ((time_s - time_s[0]) / BLOCK_S).astype(int)
    moment = np.bincount(block, np.sum(residual * rate, axis=1))
    information = np.sum(rate**2)
    return float(np.sqrt(np.sum(moment**2)) / max(information, 1e-30))
