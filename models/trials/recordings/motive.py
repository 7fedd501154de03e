"""Reader of OptiTrack Motive CSV, versions 1.2 to 1.25.

The header's first line holds key, value pairs. Label rows follow, whose second cell is their label
(Type, Name, ID, Parent, or empty for Rotation / Position), then the row that begins with Frame,
then the samples. The set of rows depends on version and export options, so every row is identified
by its label, not by its line number. A blank cell is an occluded marker. Only positions are used;
rotations of rigid bodies are skipped.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_lines
from models.shared.numeric_text import MOST_COLUMNS, read_numbers
from models.trials.recordings.mapping import RecordingMap, no_markers
from models.trials.recordings.series import Series, marker_columns
from models.trials.trial import Array

_METRES: Final = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3, "inches": 0.0254}
_RANK: Final = {"marker": 0, "rigid body marker": 1, "bone marker": 1}
"""Preference by kind, lowest first: a measured marker before the one that the solver expects."""
_MOST_HEADER_LINES: Final = 100
"""Most lines of the header; Motive writes seven."""


def read_motive_csv(path: Path, mapping: RecordingMap) -> list[Series]:
    """Read the markers of a Motive export."""
    lines = read_lines(path, "name an existing export of Motive")
    metres, labels, above = _header(path, lines)
    positions = _position_columns(path, labels, mapping)
    if not positions:
        raise no_markers(path, labels["Name"])
    cells = zip(labels["Name"][2:], labels["Frame"][2:], strict=True)
    names = [*labels["Frame"][:2], *(" ".join(filter(None, cell)) for cell in cells)]
    time = labels["Frame"].index("Time (Seconds)")
    used = [time, *(k for axes in positions.values() for k in axes)]
    samples = read_numbers(path, lines, names, used, above=above)
    columns: dict[str, Array] = {}
    for i, name in enumerate(positions):
        columns |= marker_columns({name: metres * samples[:, 1 + 3 * i : 4 + 3 * i]})
    return [Series(samples[:, 0].copy(), columns, path)]


def _header(path: Path, lines: Iterator[str]) -> tuple[float, dict[str, list[str]], int]:
    """Unit of length in m, label rows by label ("" for Rotation / Position), number of lines."""
    rows = csv.reader(lines)
    labels: dict[str, list[str]] = {}
    again = "export it from Motive again"
    try:
        metres = _length_unit(path, next(rows, []))
        for row in rows:
            if len(row) > MOST_COLUMNS:
                what = f"line {rows.line_num} has {len(row)} cells, more than {MOST_COLUMNS}"
                raise InputError(path, what, "export fewer assets")
            if row and row[0] == "Frame":
                labels["Frame"] = row
            elif len(row) > 2 and row[0] == "":
                labels[row[1]] = row
            if "Frame" in labels or rows.line_num > _MOST_HEADER_LINES:
                break
    except csv.Error as error:
        raise InputError(path, f"is not CSV text ({error})", again) from None
    if "Frame" not in labels:
        raise InputError(path, "has no row that begins with Frame", again)
    frame = labels["Frame"]
    missing = sorted({"Type", "Name", ""} - labels.keys())
    if missing or "Time (Seconds)" not in frame:
        lacks = " and ".join(map(repr, missing or ["Time (Seconds)"]))
        what = f"line {rows.line_num}: the header lacks its {lacks} row"
        raise InputError(path, what, again)
    cut = {k: (v + [""] * len(frame))[: len(frame)] for k, v in labels.items()}
    return metres, cut, rows.line_num


def _length_unit(path: Path, first: list[str]) -> float:
    """Unit of length in m, from the header's first line."""
    header = dict(zip(first[::2], first[1::2], strict=False))
    unit, space = header.get("Length Units", ""), header.get("Coordinate Space", "Global")
    if first and first[0].startswith("Format Version;"):
        what = "is separated by semicolons, with decimal commas"
        raise InputError(path, what, "export it with commas and decimal points")
    if "Format Version" not in header:
        remedy = "export CSV with 'Header Information' on"
        raise InputError(path, "is no Motive export with header", remedy)
    if unit.lower() not in _METRES:
        raise InputError(path, f"Length Units is {unit!r}", "export in Meters or Millimeters")
    if space != "Global":
        raise InputError(path, f"Coordinate Space is {space}", "export it as Global")
    return _METRES[unit.lower()]


def _position_columns(
    path: Path, labels: dict[str, list[str]], mapping: RecordingMap
) -> dict[str, list[int]]:
    """Columns of X, Y and Z by the trial's name of the marker."""
    ranks: dict[str, dict[int, dict[str, list[int]]]] = {}  # By marker, rank and axis
    cells = zip(labels["Type"], labels["Name"], labels[""], labels["Frame"], strict=True)
    for k, (kind, name, measure, axis) in enumerate(cells):
        marker = mapping.marker_of(name)
        if marker is not None and measure == "Position" and axis in ("X", "Y", "Z"):
            axes = ranks.setdefault(marker, {}).setdefault(_RANK.get(kind.lower(), 2), {})
            axes.setdefault(axis, []).append(k)
    positions = {}
    for marker, by_rank in ranks.items():
        axes = by_rank[min(by_rank)]
        for axis in "XYZ":
            if len(axes.get(axis, [])) != 1:
                raise InputError(
                    path, f"holds {len(axes.get(axis, []))} columns for {axis} of {marker}",
                    "map one marker to it, and export it with all its positions",
                )  # fmt: skip
        positions[marker] = [axes[axis][0] for axis in "XYZ"]
    return positions
