"""Goals of moves from rest to rest without inverting the twin, for comparison.

The rate-limited rigid move turns the joints as fast as the limits permit. ZVD shaping splits it in
three that leave no vibration of the first mode and little where its frequency is off (Singer and
Seering, *ASME J. Dynamic Systems* 112, 1990: zero vibration and derivative).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.safety.limits import Limits
from models.plan.paths import Timeline
from models.plant.linear_twin import LinearMode, LinearTwins, resting_modes

Array = NDArray[np.float64]


def comparison_goals(
    pointing_rad: Array,
    line: Timeline,
    limits: Limits,
    twins: LinearTwins,
    payloads_kg: Sequence[float],
    *,
    zvd: bool,
) -> list[Array]:
    """Goals of a rigid link whose moves are as fast as the limits permit, for each payload.

    `pointing_rad`, shape (n, dof): goals at which the rigid link points at the desired tip. `zvd`:
    whether moves are shaped.
    """
    period_s, tables = twins.period_s, []
    for payload_kg in payloads_kg:
        table = pointing_rad.copy()
        for first, after in line.moves:
            end = pointing_rad[after - 1]
            fast = rate_limited(pointing_rad[first], end, limits, period_s)
            table[first:after] = end
            table[first] = pointing_rad[first]
            table[first + 1 : first + 1 + len(fast)] = fast[: after - first - 1]
            late_s = 0.0
            if zvd:
                for joint, mode in enumerate(resting_modes(twins, payload_kg, end)):
                    column, impulses = table[first:after, joint], zvd_impulses(mode)
                    table[first:after, joint] = shaped(column, impulses, period_s)
                    late_s = max(late_s, impulses[-1][0])
            if len(fast) * period_s + late_s > (after - first - 1) * period_s:
                raise InputError("--seconds", "leaves no rest after a move", "give more time")
        tables.append(table)
    return tables


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


def zvd_impulses(mode: LinearMode) -> list[tuple[float, float]]:
    """Delay in s and weight of each of the three impulses."""
    k, half = mode.decay, mode.half_period_s
    total = (1.0 + k) ** 2
    return [(0.0, 1.0 / total), (half, 2.0 * k / total), (2.0 * half, k * k / total)]


def shaped(column: Array, impulses: list[tuple[float, float]], period_s: float) -> Array:
    """Sum of delayed copies of a column (n,) that rests at its first value before, shape (n,)."""
    rows = np.arange(len(column), dtype=np.float64)
    copies = [w * np.interp(rows - delay / period_s, rows, column) for delay, w in impulses]
    return np.asarray(np.sum(copies, axis=0))
