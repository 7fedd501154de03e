"""Reader of OptiTrack Motive CSV, versions 1.2 to 1.25.

The header's first line holds key, value pairs. Label rows follow, whose second cell is their label
(Type, Name, ID, Parent, or empty for Rotation / Position), then the row that begins with Frame,
then the samples. The set of rows depends on the version and on the export options, so every row is
found by its label, not by its line number. A blank cell is an occluded marker. Only positions are
used; rotations of rigid bodies are skipped.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from models.trials.importers.mapping import RecordingMap
from models.trials.importers.mocap_frame import to_world
from models.trials.importers.series import Series, marker_columns
from models.trials.trial import Array

_METRES: Final = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3, "inches": 0.0254}
_RANK: Final = {"marker": 0, "rigid body marker": 1, "bone marker": 1}
"""Preference by kind, lowest first: a measured marker before the solver's expected one."""


def read_motive_csv(path: Path, mapping: RecordingMap) -> list[Series]:
    """Markers of a Motive export in the world frame.

    Parameters
    ----------
    path : Path
        CSV file.
    mapping : RecordingMap
        With `[markers]` and `[frame]`; y points up unless it says otherwise.

    Raises
    ------
    InputError
        If the file is no Motive export in a known length unit and global coordinates, is
        truncated, or holds no mapped marker.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            path, f"is not CSV text ({error})", "export it from Motive again"
        ) from None
    header = _header(path, rows)
    metres = _METRES[header["Length Units"].lower()]
    labels, start = _label_rows(path, rows)
    positions = _position_columns(labels, mapping)
    if not positions:
        found = sorted({name for name in labels["Name"] if name})
        raise InputError(
            path,
            "holds none of the mapped markers; it has " + (", ".join(found[:20]) or "no names"),
            'map them under [markers] in MAP.toml, like m01 = "Link:Marker1"',
        )
    width = len(labels["Frame"])
    samples = _samples(path, rows, start, width)
    time = labels["Frame"].index("Time (Seconds)")
    markers_m = {name: metres * samples[:, axes] for name, axes in positions.items()}
    world_m = to_world(markers_m, mapping.frame, default_up="y")
    return [Series(samples[:, time], marker_columns(world_m), path)]


def _header(path: Path, rows: list[list[str]]) -> dict[str, str]:
    """Key, value pairs of the header's first line, checked."""
    first = rows[0] if rows else []
    header = dict(zip(first[::2], first[1::2], strict=False))
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


def _label_rows(path: Path, rows: list[list[str]]) -> tuple[dict[str, list[str]], int]:
    """Label rows by label ("" is the Rotation / Position row), and the first row of samples."""
    labels: dict[str, list[str]] = {}
    for number, row in enumerate(rows[1:], start=1):
        if row and row[0] == "Frame":
            labels["Frame"] = row
            missing = {"Type", "Name", ""} - labels.keys()
            if missing or "Time (Seconds)" not in row:
                raise InputError(
                    path,
                    f"line {number + 1}: the header lacks its {missing or {'Time (Seconds)'}} row",
                    "export it from Motive again",
                )
            return {k: v + [""] * (len(row) - len(v)) for k, v in labels.items()}, number + 1
        if len(row) > 2 and row[0] == "":
            labels[row[1]] = row
    raise InputError(path, "has no row that begins with Frame", "export it from Motive again")


def _position_columns(labels: dict[str, list[str]], mapping: RecordingMap) -> dict[str, list[int]]:
    """Columns of X, Y and Z by the contract's marker name."""
    best: dict[str, tuple[int, dict[str, int]]] = {}
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
            best[marker][1].setdefault(axis, k)
    return {name: [axes["X"], axes["Y"], axes["Z"]] for name, (_, axes) in best.items()}


def _samples(path: Path, rows: list[list[str]], start: int, width: int) -> Array:
    """All cells below the header as numbers, blank ones as NaN."""
    body = [row for row in rows[start:] if row]
    samples = np.full((len(body), width), np.nan)
    for i, row in enumerate(body):
        if len(row) < width:
            raise InputError(
                path, f"line {start + i + 1} has {len(row)} cells, the header {width}",
                "the file is truncated: export it again",
            )  # fmt: skip
        for k, cell in enumerate(row[:width]):
            if cell == "":
                continue
            try:
                samples[i, k] = float(cell)
            except ValueError:
                raise InputError(
                    path, f"line {start + i + 1}, cell {k + 1}: {cell!r} is not a number",
                    "export it from Motive again",
                ) from None  # fmt: skip
    return samples
