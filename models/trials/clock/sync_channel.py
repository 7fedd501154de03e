"""Offset between two clocks from a hardware synchronisation signal that both files recorded.

An edge is between two samples, so each pair of edges gives an interval of the offset. The offset is
in the intervals of all pairs, so more edges leave a smaller interval.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from models.trials.clock.offset_fit import ClockDrift
from models.trials.trial import Array

LEAST_SWING_V: Final = 0.5
"""Smallest difference between the levels of the signal [assumed: logic is at 1.8 V or more]."""
JITTER_S: Final = 2e-4
"""Error of a time stamp [assumed]."""
DRIFT: Final = 3e-5
"""Relative difference of two clocks' rates: a crystal's tolerance of 30 ppm [assumed]."""
LEAST_PAIRS: Final = 4
"""Fewest pairs of edges for a fit of the drift [assumed]."""
LEAST_SHARED: Final = 0.5
"""Smallest fraction of edges with a partner, in the file with fewer edges."""


class EdgeOffset(NamedTuple):
    """Interval of offsets at which the edges of two files match."""

    low_s: float  # Lower and upper end of the interval; add the offset to the servo's times
    high_s: float
    shared: int  # Number of matching pairs of edges
    # Change of the offset from the first pair to the last; None for fewer than `LEAST_PAIRS`
    drift: ClockDrift | None = None

    @property
    def offset_s(self) -> float:
        """Middle of the interval in s."""
        return 0.5 * (self.low_s + self.high_s)

    @property
    def error_s(self) -> float:
        """Half of the interval's width in s."""
        return 0.5 * (self.high_s - self.low_s)


def rising_edges_s(time_s: Array, level_v: Array) -> Array:
    """Times of the samples before and after each rise through mid-range, shape (edges, 2)."""
    seen = np.isfinite(level_v)
    time_s, level_v = time_s[seen], level_v[seen]
    if len(level_v) < 2 or np.ptp(level_v) < LEAST_SWING_V:
        return np.zeros((0, 2))
    middle = 0.5 * (level_v.min() + level_v.max())
    at = np.flatnonzero((level_v[:-1] < middle) & (level_v[1:] >= middle))
    return np.column_stack([time_s[at], time_s[at + 1]])


def edge_offsets(servo_s: Array, mocap_s: Array) -> list[EdgeOffset]:
    """Offsets at which the edges (edges, 2) of two files match, the one with the most pairs first.

    Either file may lack edges at its ends. There are several offsets if the signal is periodic, and
    none if nothing matches.
    """
    least = max(LEAST_SHARED * min(len(servo_s), len(mocap_s)), 1)
    found = []
    for shift in range(1 - len(servo_s), len(mocap_s)):
        servo = servo_s[max(-shift, 0) :]
        mocap = mocap_s[max(shift, 0) :]
        shared = min(len(servo), len(mocap))
        if shared < least:
            continue
        servo, mocap = servo[:shared], mocap[:shared]
        slack_s = JITTER_S + DRIFT * float(servo[-1, 1] - servo[0, 0])
        low_s = float(np.max(mocap[:, 0] - servo[:, 1])) - slack_s
        high_s = float(np.min(mocap[:, 1] - servo[:, 0])) + slack_s
        if low_s <= high_s:
            found.append(EdgeOffset(low_s, high_s, shared, _drift(servo, mocap)))
    return sorted(found, key=lambda fit: -fit.shared)


def _drift(servo_s: Array, mocap_s: Array) -> ClockDrift | None:
    """Change of the offset over pairs of edges, by a line through the middles of their intervals.

    An edge is uniformly distributed between its two samples: its variance is a twelfth of the
    square of their distance.
    """
    if len(servo_s) < LEAST_PAIRS:
        return None
    time_s = mocap_s.mean(axis=1)
    offset_s = time_s - servo_s.mean(axis=1)
    centred_s = time_s - time_s.mean()
    slope = float(centred_s @ offset_s / (centred_s @ centred_s))
    widths_s = [np.median(edges[:, 1] - edges[:, 0]) for edges in (servo_s, mocap_s)]
    deviation_s = np.hypot(np.linalg.norm(widths_s) / np.sqrt(12.0), JITTER_S)
    over_s = float(time_s[-1] - time_s[0])
    slope_deviation = float(deviation_s / np.linalg.norm(centred_s))
    return ClockDrift(slope * over_s, slope_deviation * over_s, over_s)
