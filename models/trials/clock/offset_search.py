"""Search over all offsets at which two recordings of one motion agree, and over the signs.

On a coarse grid, the correlation coefficient of the servo's angles and the link's directions is
computed at every offset at which the overlap contains half of the motion of one file. The same is
done with signs reversed or joints swapped, so that a wrong sign is not mistaken for a shift by half
a period.
"""

from __future__ import annotations

from itertools import permutations, product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from models.trials.trial import Array

COARSE_STEP_S: Final = 0.01
"""Step of the search in s."""

LEAST_OVERLAP: Final = 0.5
"""Smallest fraction of the motion of one file in the overlap."""

SEPARATION_S: Final = 0.25
"""Smallest distance of two peaks: the period of the fastest motion, 4 Hz."""


class ClockSignal(NamedTuple):
    """Samples `values` (n, dof) at times `time_s` (n,)."""

    time_s: Array
    values: Array


class Reading(NamedTuple):
    """Order and signs in which the servo's angles are read."""

    # Which of the file's angles is compared with direction 1 and 2, counted from 0
    joints: tuple[int, ...]
    signs: tuple[int, ...]

    @property
    def as_mapped(self) -> bool:
        """Whether no sign is reversed and no joints are swapped."""
        return self.joints == tuple(sorted(self.joints)) and min(self.signs) > 0


class Peak(NamedTuple):
    """Local maximum of the correlation over the offset."""

    offset_s: float
    correlation: float
    reading: Reading


def find_peaks(angle: ClockSignal, seen: ClockSignal) -> list[Peak]:
    """Best offsets of the angles as mapped, then the best one of each other reading.

    There are two peaks of the mapped reading (one if no other is far enough) and one of each other
    reading; none if the files have too little in common.
    """
    a, b = _even(angle), _even(seen)
    moments = _moments(a, b)
    start_s = float(seen.time_s[0] - angle.time_s[0])
    peaks: list[Peak] = []
    dof = angle.values.shape[1]
    for joints in permutations(range(dof)):
        for signs in product((1, -1), repeat=dof):
            reading = Reading(joints, signs)
            score = moments.correlation(reading)
            for k in _best(score, 2 if reading.as_mapped else 1):
                lag = k - (len(a) - 1)
                peaks.append(Peak(start_s + lag * COARSE_STEP_S, float(score[k]), reading))
    return peaks


class _Moments(NamedTuple):
    """Sums over the overlap at every lag: variances of both signals, covariances of all pairs."""

    variance_a: Array
    variance_b: Array
    covariance: Array
    enough: NDArray[np.bool_]

    def correlation(self, reading: Reading) -> Array:
        pairs = zip(reading.joints, reading.signs, strict=True)
        shared = sum(
            sign * self.covariance[:, joint, axis] for axis, (joint, sign) in enumerate(pairs)
        )
        size = np.sqrt(np.maximum(self.variance_a * self.variance_b, 1e-30))
        return np.asarray(np.where(self.enough, shared / size, -1.0))


def _even(signal: ClockSignal) -> Array:
    grid_s = np.arange(signal.time_s[0], signal.time_s[-1], COARSE_STEP_S)
    columns = [np.interp(grid_s, signal.time_s, column) for column in signal.values.T]
    return np.asarray(np.column_stack(columns) - signal.values[0])


def _moments(a: Array, b: Array) -> _Moments:
    def over(x: Array, y: Array) -> Array:
        return np.asarray(correlate(y, x, mode="full", method="fft"))

    one_a, one_b = np.ones(len(a)), np.ones(len(b))
    count = np.maximum(np.round(over(one_a, one_b)), 1.0)
    sum_a = np.column_stack([over(x, one_b) for x in a.T])
    sum_b = np.column_stack([over(one_a, y) for y in b.T])
    square_a, square_b = over((a**2).sum(axis=1), one_b), over(one_a, (b**2).sum(axis=1))
    covariance = np.stack(
        [
            np.column_stack([over(x, y) - sum_a[:, i] * sum_b[:, j] / count for j, y in _axes(b)])
            for i, x in _axes(a)
        ],
        axis=1,
    )
    held = np.maximum(square_a / max(np.sum(a**2), 1e-30), square_b / max(np.sum(b**2), 1e-30))
    return _Moments(
        square_a - (sum_a**2).sum(axis=1) / count,
        square_b - (sum_b**2).sum(axis=1) / count,
        covariance,
        (held >= LEAST_OVERLAP) & (count > 2),
    )


def _axes(values: Array) -> list[tuple[int, Array]]:
    return list(enumerate(values.T))


def _best(score: Array, count: int) -> list[int]:
    """Indices of the highest local maxima at least `SEPARATION_S` apart."""
    apart = round(SEPARATION_S / COARSE_STEP_S)
    inner = (score[1:-1] >= score[:-2]) & (score[1:-1] >= score[2:])
    at = np.flatnonzero(inner) + 1
    at = at[score[at] > 0]
    chosen: list[int] = []
    for k in at[np.argsort(-score[at], kind="stable")].tolist():
        if all(abs(k - other) > apart for other in chosen):
            chosen.append(k)
        if len(chosen) == count:
            break
    return chosen
