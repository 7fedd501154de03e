"""Offset between two clocks from a hardware synchronisation signal that both files recorded."""

from __future__ import annotations

from typing import Final

import numpy as np

from models.trials.trial import Array

LEAST_SWING_V: Final = 0.5
"""Smallest difference between the levels of the signal [assumed: logic is at 1.8 V or more]."""


def rising_edges_s(time_s: Array, level_v: Array) -> Array:
    """Times at which a signal crosses the middle of its range upwards, linearly interpolated.

    Parameters
    ----------
    time_s, level_v : ndarray, shape (n,)
        Samples; those that are not finite are left out.

    Examples
    --------
    >>> rising_edges_s(np.arange(6.0), np.array([0.0, 0, 4, 4, 0, 4]))
    array([1.5, 4.5])
    """
    seen = np.isfinite(level_v)
    time_s, level_v = time_s[seen], level_v[seen]
    if len(level_v) < 2 or np.ptp(level_v) < LEAST_SWING_V:
        return np.zeros(0)
    middle = 0.5 * (level_v.min() + level_v.max())
    at = np.flatnonzero((level_v[:-1] < middle) & (level_v[1:] >= middle))
    fraction = (middle - level_v[at]) / (level_v[at + 1] - level_v[at])
    return np.asarray(time_s[at] + fraction * (time_s[at + 1] - time_s[at]))


def edge_offset_s(servo_s: Array, mocap_s: Array) -> tuple[float, float] | None:
    """Offset to be added to the servo's times, and the half width of its 95 % interval.

    Parameters
    ----------
    servo_s, mocap_s : ndarray
        Edges in each file. If one file has fewer, they are taken for a run of the other's.

    Returns
    -------
    tuple of float or None
        None where an edge is missing or no run of edges fits to within 5 ms.
    """
    few, many = sorted((servo_s, mocap_s), key=len)
    if not len(few):
        return None
    found: list[tuple[float, float]] = []
    for k in range(len(many) - len(few) + 1):
        apart_s = many[k : k + len(few)] - few
        found.append((float(np.std(apart_s)), float(np.median(apart_s))))
    deviation_s, median_s = min(found)
    ambiguous = len(found) > 1 and sorted(found)[1][0] < 3 * deviation_s + 1e-4
    if deviation_s > 5e-3 or ambiguous:
        return None
    sign = 1.0 if few is servo_s else -1.0
    return sign * median_s, float(1.96 * deviation_s / np.sqrt(len(few)))
