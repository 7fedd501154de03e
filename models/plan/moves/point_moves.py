"""Moves from one place of the tip to another without inverting the twin, for comparison.

The rate-limited rigid move turns the joints as fast as the limits permit. ZVD shaping splits it in
three that leave no vibration of the first mode and little where its frequency is off (Singer and
Seering, *ASME J. Dynamic Systems* 112, 1990: zero vibration and derivative).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from firmware_py.safety.limits import Limits
from models.plan.moves.vibration_mode import VibrationMode

Array = NDArray[np.float64]


def rate_limited(start_rad: Array, end_rad: Array, limits: Limits, period_s: float) -> Array:
    """Goals of the fastest move within rate and acceleration, all joints together, shape (n, dof).

    The last row is the end. Shapes: `start_rad`, `end_rad` (dof,).
    """
    distance, most = float(np.max(np.abs(end_rad - start_rad))), limits.acceleration_rad_s2
    rate = min(limits.rate_rad_s, math.sqrt(distance * most))
    if distance == 0.0:
        return np.asarray(end_rad)[None, :]
    rise_s, total_s = rate / most, distance / rate + rate / most
    at_s = np.minimum(period_s * np.arange(1, math.ceil(total_s / period_s) + 1), total_s)
    # Ramps of the rate at both ends; sampled, no mean rate over a period exceeds them.
    ramps = [np.maximum(at_s - t, 0.0) ** 2 for t in (0.0, rise_s, total_s - rise_s, total_s)]
    way = 0.5 * most * (ramps[0] - ramps[1] - ramps[2] + ramps[3]) / distance
    return np.asarray(start_rad + way[:, None] * (end_rad - start_rad))


def zvd_impulses(mode: VibrationMode) -> list[tuple[float, float]]:
    """Delay in s and weight of each of the three impulses."""
    k, half = mode.decay, mode.half_period_s
    total = (1.0 + k) ** 2
    return [(0.0, 1.0 / total), (half, 2.0 * k / total), (2.0 * half, k * k / total)]


def shaped(column: Array, impulses: list[tuple[float, float]], period_s: float) -> Array:
    """Sum of delayed copies of a column that rests at its first value before, shape (n,).

    Shapes: `column` (n,).
    """
    rows = np.arange(len(column), dtype=np.float64)
    copies = [w * np.interp(rows - delay / period_s, rows, column) for delay, w in impulses]
    return np.asarray(np.sum(copies, axis=0))
