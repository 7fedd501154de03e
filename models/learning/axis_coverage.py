"""Coverage of an interval, counted on the axes along which the tip moves."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import FRACTION

__all__ = ["COVERS", "MOVING_AXES", "AxisCoverage", "axis_coverage", "coverage_text"]

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
