"""Positions of the markers on a link: rows along it, with the same corners in every row."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.core.errors import InputError

MOST_MARKERS: Final = 99
"""Most markers, because their names have two digits."""

STUDY_ROWS: Final = 4
"""Number of equidistant rows on the study's link (docs/sources.md, "The link")."""

AT_TIP_M: Final = 0.002
"""Largest distance of the last row from the end of the link."""


class MarkerLayout(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Positions of the markers m01, m02, … row by row from the base."""

    # Height of each row above the base plate; the last row is that of the end effector
    rows_m: tuple[float, ...]
    # Position of each marker of a row at zero angle, x and y from the axis. A long edge is the line
    # from the base plate through the same corner of all rows.
    corners_m: tuple[tuple[float, float], ...]

    @property
    def rows(self) -> int:
        return len(self.rows_m)

    @property
    def corners(self) -> int:
        return len(self.corners_m)

    @property
    def count(self) -> int:
        return self.rows * self.corners

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"m{k:02d}" for k in range(1, self.count + 1))

    def row(self, number: int) -> tuple[str, ...]:
        first = (number % self.rows) * self.corners
        return self.names[first : first + self.corners]

    @property
    def tip_row(self) -> slice:
        """Slice of the last row among the markers."""
        return slice(self.count - self.corners, self.count)

    def check(self, where: Path | str, length_m: float) -> None:
        """Refuse a layout that does not fit a link of this length."""
        numbers = (*self.rows_m, *(v for corner in self.corners_m for v in corner))
        if not all(math.isfinite(v) for v in numbers):
            raise InputError(where, "[markers] holds a value that is no number", "correct it")
        if not 1 <= self.count <= MOST_MARKERS:
            raise InputError(
                where, f"[markers] has {self.rows} rows of {self.corners}",
                f"give 1 to {MOST_MARKERS} markers",
            )  # fmt: skip
        if any(b <= a for a, b in zip((0.0, *self.rows_m), self.rows_m, strict=False)):
            raise InputError(
                where, "[markers] rows_m do not ascend from the base plate", "sort them, above 0"
            )
        if any(abs(sum(side)) > AT_TIP_M for side in zip(*self.corners_m, strict=True)):
            raise InputError(
                where, "[markers] corners_m do not surround the axis", "their mean must be [0, 0]"
            )
        if abs(self.rows_m[-1] - length_m) > AT_TIP_M:
            raise InputError(
                where, f"[markers] the last row is at {self.rows_m[-1]:g} m, the link ends at "
                f"{length_m:g} m", "count the length of the link to its last row",
            )  # fmt: skip


def square_corners_m(width_m: float) -> tuple[tuple[float, float], ...]:
    """Return the corners of a square section: (+x, +y), (-x, +y), (+x, -y), (-x, -y)."""
    half = 0.5 * width_m
    return tuple((sx * half, sy * half) for sy in (1, -1) for sx in (1, -1))


def square_layout(length_m: float, width_m: float, rows: int = STUDY_ROWS) -> MarkerLayout:
    """Return equidistant rows with a marker at each corner of a square section."""
    heights = tuple(length_m * row / rows for row in range(1, rows + 1))
    return MarkerLayout(heights, square_corners_m(width_m))
