"""Path of the tip from a CSV file of time and position."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.files.input_files import read_text
from models.plan.path_shapes import DesiredPath

Array = NDArray[np.float64]
FARTHEST_M: Final = 2.0
"""Largest coordinate, the same as for built-in paths."""
LONGEST_S: Final = 600.0
"""Longest path [assumed]."""
MOST_PATH_BYTES: Final = 10_000_000
"""Size of the largest file of a path: 600 s at 1 kHz with 16 characters a row [assumed]."""


def read_path(path: Path, dof: int, period_s: float) -> DesiredPath:
    """Read a path: a line of names (time_s, x_m, and y_m with two joints), then rising times.

    The path is interpolated to the control period. If it ends between two periods, the nearer one
    counts; past the end the tip continues at its last speed.
    """
    names = ["time_s", "x_m", "y_m"][: dof + 1]
    remedy = f"give the columns {','.join(names)} in s and m"
    lines = read_text(path, remedy, MOST_PATH_BYTES).split("\n")
    head = [name.strip() for name in lines[0].split(",")]
    if head != names:
        raise InputError(path, f"has the columns {lines[0].strip()[:80]!r}", remedy)
    rows: list[list[float]] = []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        try:
            row = [float(cell) for cell in line.split(",")]
        except ValueError:
            row = []
        if len(row) != len(names) or not np.isfinite(row).all():
            raise InputError(
                path, f"row {number} is {line.strip()[:80]!r}", f"write {len(names)} numbers"
            )
        if rows and row[0] <= rows[-1][0]:
            raise InputError(path, f"row {number}: time_s does not rise", "sort the rows by time")
        if max(map(abs, row[1:])) > FARTHEST_M:
            raise InputError(
                path, f"row {number} leads {max(map(abs, row[1:])):g} m away",
                f"give places in m, {FARTHEST_M:g} at most",
            )  # fmt: skip
        rows.append(row)
    if len(rows) < 2:
        raise InputError(path, f"has {len(rows)} rows", "give 2 or more")
    if not 2 * period_s <= (lasts_s := rows[-1][0] - rows[0][0]) <= LONGEST_S:
        raise InputError(path, f"lasts {lasts_s:g} s", f"give {2 * period_s:g} to {LONGEST_S:g} s")
    table = np.array(rows)
    at_s = np.arange(table[0, 0], table[-1, 0] + 0.5 * period_s, period_s)
    tip = _at(table, at_s)
    # The way back starts at the speed of the end: a last row at rest would halve it.
    end_s = table[-1, 0]
    end, before = _at(table, np.array([end_s, end_s - period_s]))
    tip[-1] += max(0.0, at_s[-1] - end_s) * (end - before) / period_s
    return DesiredPath(path.stem, tip, ((0, len(at_s)),))


def _at(table: Array, at_s: Array) -> Array:
    """Positions of a table of time and position at given times, shape (n, dof)."""
    return np.column_stack([np.interp(at_s, table[:, 0], column) for column in table.T[1:]])
