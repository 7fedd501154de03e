"""Measures of predictors: distances, folds without leakage, coverage of an interval."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import FRACTION
from models.predictor.onnx_graphs import Array
from models.predictor.polynomials import Fold

BLOCKS: Final = 5
"""Number of blocks of each run."""
GAP_S: Final = 1.0
"""Time around a held-out block whose rows are not used in training [assumed]. Rows 17 ms apart are
nearly equal, so without a gap a block would be tested on its own training data."""


def euclidean_distance_m(actual_m: Array, predicted_m: Array) -> Array:
    """Distance between end effectors in m, row by row (paper, eq. 4 to 7), (n,)."""
    return np.asarray(np.linalg.norm(actual_m - predicted_m, axis=1), dtype=np.float64)


def r_squared(actual: Array, estimate: Array) -> float:
    """Coefficient of determination R²; negative if worse than the mean."""
    return float(1.0 - np.sum((actual - estimate) ** 2) / np.sum((actual - actual.mean()) ** 2))


def block_folds(run: NDArray[np.intp], time_s: Array) -> list[Fold]:
    """Folds of five contiguous blocks of each run, with 1 s gaps around the held-out block.

    Shapes: `run` (n,), `time_s` (n,).
    """
    edges = np.zeros((len(run), BLOCKS + 1))
    for number in np.unique(run):
        rows = run == number
        edges[rows] = np.linspace(time_s[rows].min(), time_s[rows].max(), BLOCKS + 1)
    folds = []
    for block in range(BLOCKS):
        start_s, end_s = edges[:, block], edges[:, block + 1]
        last = block == BLOCKS - 1
        test = (time_s >= start_s) & ((time_s <= end_s) if last else (time_s < end_s))
        train = (time_s <= start_s - GAP_S) | (time_s >= end_s + GAP_S)
        folds.append((np.flatnonzero(train), np.flatnonzero(test)))
    return folds


def payload_folds(payload_kg: Array) -> list[Fold]:
    """One fold per payload, which that fold holds out."""
    return [
        (np.flatnonzero(payload_kg != kg), np.flatnonzero(payload_kg == kg))
        for kg in np.unique(payload_kg)
    ]


MOVING_AXES: Final = {1: (0, 2), 2: (0, 1, 2)}
"""World axes along which the tip moves, by number of joints. Joint 1 alone turns the link in the
plane of x and z: y is always covered, and a mean over three axes would hide a third of the misses.
"""
COVERS: Final = "interval covers in %, mean / worst axis"
"""Heading of a column of `coverage_text`."""


class AxisCoverage(NamedTuple):
    """Fraction of the rows inside an interval."""

    mean: float  # Mean over the axes that move
    least: float  # On the worst of the axes that move


def axis_coverage(inside: NDArray[np.bool_], dof: int) -> AxisCoverage:
    """Mean and least coverage over the axes that move.

    `inside`, shape (n, 3): whether each row is covered, by axis; at least one row.
    """
    by_axis = inside[:, list(MOVING_AXES[dof])].mean(axis=0)
    return AxisCoverage(float(by_axis.mean()), float(by_axis.min()))


def coverage_text(mean: float, least: float) -> str:
    """Both values in %, as in the tables."""
    return f"{FRACTION.number(mean, 1)} / {FRACTION.number(least, 1)}"
