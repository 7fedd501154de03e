"""Measures of predictors: distance of the tip, and coverage of an interval."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.units import FRACTION
from models.predictor.onnx_graphs import Array

MOVING_AXES: Final = {1: (0, 2), 2: (0, 1, 2)}
"""World axes along which the tip moves, by number of joints. Joint 1 alone turns the link in the
plane of x and z: y is always covered, and a mean over three axes would hide a third of the misses.
"""
COVERS: Final = "interval covers in %, mean / worst axis"  # Heading of a column of `coverage_text`


def euclidean_distance_m(actual_m: Array, predicted_m: Array) -> Array:
    """Distance between end effectors in m, row by row (paper, eq. 4 to 7), (n,)."""
    return np.asarray(np.linalg.norm(actual_m - predicted_m, axis=1), dtype=np.float64)


class AxisCoverage(NamedTuple):
    """Fraction of the rows inside an interval: mean and least over the axes that move."""

    mean: float
    least: float


def axis_coverage(inside: NDArray[np.bool_], dof: int) -> AxisCoverage:
    """Coverage of rows, of which there is at least one; `inside` (n, 3): row by axis."""
    by_axis = inside[:, list(MOVING_AXES[dof])].mean(axis=0)
    return AxisCoverage(float(by_axis.mean()), float(by_axis.min()))


def coverage_text(mean: float, least: float) -> str:
    """Both values in %, as in the tables."""
    return f"{FRACTION.number(mean, 1)} / {FRACTION.number(least, 1)}"
