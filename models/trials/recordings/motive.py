"""Reader of OptiTrack Motive CSV, versions 1.2 to 1.25.

The header's first line holds key, value pairs. Label rows follow, whose second cell is their label
(Type, Name, ID, Parent, or empty for Rotation / Position), then the row that begins with Frame,
then the samples. The set of rows depends on version and export options, so every row is identified
by its label, not by its line number. A blank cell is an occluded marker. Only positions are used;
rotations of rigid bodies are skipped.
"""

from __future__ import annotations

import csv
import math
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS, read_lines
from models.trials.files import MOST_COLUMNS
from models.trials.recordings.frame import to_world
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series, marker_columns
from models.trials.recordings.text import cells_remedy, has_decimal_comma
from models.trials.trial import Array

_METRES: Final = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3, "inches": 0.0254}
_RANK: Final = {"marker": 0, "rigid body marker": 1, "bone marker": 1}
"""Preference by kind, lowest first: a measured marker before the one that the solver expects."""
_MOST_HEADER_LINES: Final = 100
"""Most lines of the header; Motive writes seven."""


def read_motive_csv(path: Path, mapping: RecordingMap) -> list[Series]:
    """Read the markers of a Motive export, in the world frame.

    y points up unless the map's `[frame]` says otherwise.
    """
    rows = _rows(path)
    header = _header(path, next(rows, []))
    metres = _METRES[header["Length Units"].lower()]
    labels, line = _label_rows(path, rows)
    positions = _position_columns(path, labels, mapping)
    if not positions:
        found = sorted({name for name in labels["Name"] if name})
        raise InputError(
            path,
            "holds none of the mapped markers; it has " + (", ".join(found[:20]) or "no names"),
            'map them under [markers] in MAP.toml, like m01 = "Link:Marker1"',
        )
    time = labels["Frame"].index("Time (Seconds)")
    used = [time, *(k for axes in positions.values() for k in axes)]
    samples = _samples(path, rows, line, len(labels["Frame"]), used)
    columns: dict[str, Array] = {}
    for i, name in enumerate(positions):  # one by one: one copy of a long capture, not four
        in_file_m = metres * samples[:, 1 + 3 * i : 4 + 3 * i]
        columns |= marker_columns(to_world({name: in_file_m}, mapping.frame, default_up="y"))
    return [Series(samples[:, 0].copy(), columns, path)]


def _rows(path: Path) -> Iterator[list[str]]:
    try:
        yield from csv.reader(read_lines(path, "name an existing export of Motive"))
    except csv.Error as error:
        raise InputError(
            path, f"is not CSV text ({error})", "export it from Motive again"
        ) from None


def _header(path: Path, first: list[str]) -> dict[str, str]:
    """Check the header's first line and return its key, value pairs."""
    header = dict(zip(first[::2], first[1::2], strict=False))
    if first and first[0].startswith("Format Version;"):
        raise InputError(
            path, "is separated by semicolons, with decimal commas",
            "export it with commas and decimal points",
        )  # fmt: skip
    if "Format Version" not in header:
        raise InputError(
            path, "is no Motive export with header", "export CSV with 'Header Information' on"
        )
    units = header.get("Length Units", "")
    if units.lower() not in _METRES:
        raise InputError(path, f"Length Units is {units!r}", "export in Meters or Millimeters")
    if header.get("Coordinate Space", "Global") != "Global":
        raise InputError(
            path, f"Coordinate Space is {header['Coordinate Space']}", "export it as Global"
        )
    return header


def _label_rows(path: Path, rows: Iterator[list[str]]) -> tuple[dict[str, list[str]], int]:
    """Label rows by label ("" for Rotation / Position), and the line number of the last one."""
    labels: dict[str, list[str]] = {}
    for number, row in enumerate(rows, start=2):
        if len(row) > MOST_COLUMNS:
            what = f"line {number} has {len(row)} cells, more than {MOST_COLUMNS}"
            raise InputError(path, what, "export fewer assets")
        if row and row[0] == "Frame":
            labels["Frame"] = row
            missing = {"Type", "Name", ""} - labels.keys()
            if missing or "Time (Seconds)" not in row:
                lacks = " and ".join(map(repr, sorted(missing) or ["Time (Seconds)"]))
                raise InputError(
                    path, f"line {number}: the header lacks its {lacks} row",
                    "export it from Motive again",
                )  # fmt: skip
            return {k: (v + [""] * len(row))[: len(row)] for k, v in labels.items()}, number
        if len(row) > 2 and row[0] == "":
            labels[row[1]] = row
        if number > _MOST_HEADER_LINES:
            break
    raise InputError(path, "has no row that begins with Frame", "export it from Motive again")


def _position_columns(
    path: Path, labels: dict[str, list[str]], mapping: RecordingMap
) -> dict[str, list[int]]:
    """Columns of X, Y and Z by the trial's name of the marker."""
    best: dict[str, tuple[int, dict[str, list[int]]]] = {}
    for k, (kind, name, measure, axis) in enumerate(
        zip(labels["Type"], labels["Name"], labels[""], labels["Frame"], strict=True)
    ):
        marker = mapping.marker_of(name)
        rank = _RANK.get(kind.lower(), 2)
        if marker is None or measure != "Position" or axis not in ("X", "Y", "Z"):
            continue
        if marker not in best or rank < best[marker][0]:
            best[marker] = (rank, {})
        if rank == best[marker][0]:
            best[marker][1].setdefault(axis, []).append(k)
    for name, (_, axes) in best.items():
        for axis in "XYZ":
            count = len(axes.get(axis, []))
            if count != 1:
                raise InputError(
                    path, f"holds {count} columns for {axis} of {name}",
                    "map one marker to it, and export it with all its positions",
                )  # fmt: skip
    return {name: [axes[axis][0] for axis in "XYZ"] for name, (_, axes) in best.items()}


def _samples(
    path: Path, rows: Iterator[list[str]], line: int, width: int, used: list[int]
) -> Array:
    """Samples of the used columns as numbers, NaN for a blank cell."""
    numbers = array("d")
    for number, row in enumerate(rows, start=line + 1):
        if not row:
            continue
        if len(row) < width or len(row) >= 1.5 * width:
            raise InputError(
                path, f"line {number} has {len(row)} cells, the header {width}",
                cells_remedy(row, width),
            )  # fmt: skip
        if len(numbers) > MOST_CELLS:
            raise InputError(path, f"holds more than {MOST_CELLS} numbers", "export less of it")
        try:
            values = [float(cell) if cell else math.nan for cell in row[:width]]
        except ValueError:
            raise _no_number(path, number, row) from None
        numbers.extend([values[k] for k in used])
    return np.frombuffer(numbers, np.float64).reshape(-1, len(used))


def _no_number(path: Path, line: int, row: list[str]) -> InputError:
    k, cell = next((k, c) for k, c in enumerate(row, start=1) if not _is_number(c))
    remedy = "export it from Motive again"
    if has_decimal_comma(cell):
        remedy = "the file has decimal commas: export it with decimal points"
    return InputError(path, f"line {line}, cell {k}: {cell[:80]!r} is not a number", remedy)


def _is_number(cell: str) -> bool:
    try:
        float(cell or 0)
    except ValueError:
        return False
    return True
