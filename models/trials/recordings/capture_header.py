"""Header of a marker export as text: QTM's TSV, and the TRC of OpenSim and other programs.

Both are tables below rows of metadata. QTM writes `KEY<tab>value`, with the names in
`MARKER_NAMES`, and may omit the columns `Frame` and `Time` and their header row. TRC has five
header rows, with a name over every third column. The columns become `Frame`, `Time`, `NAME X`,
`NAME Y`, `NAME Z`.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from firmware_py.errors import InputError
from firmware_py.signals import TIME
from models.shared.numeric_text import MOST_COLUMNS
from models.trials.recordings.mapping import ColumnSource, RecordingMap

_KEY: Final = re.compile(r"[A-Z_]+")
_MOST_FACTS: Final = 100
"""Most rows of metadata in QTM's header; it writes ten to twelve."""


class CaptureHeader(NamedTuple):
    """Header of a marker export."""

    markers: tuple[str, ...]  # Names in the file
    unit: str  # Unit of length
    rows: int  # Number of header rows
    rate_hz: float | None = None  # Rate of rows without a time; None if rows have a time

    @property
    def columns(self) -> list[str]:
        """Names of the columns that the rows have."""
        return ["Frame", "Time", *(f"{name} {axis}" for name in self.markers for axis in "XYZ")]

    def complete(self, mapping: RecordingMap) -> RecordingMap:
        """Map with columns and units of the time and of `[markers]`."""
        columns = {TIME.name: ColumnSource(source="Time", unit="s")}
        for name in self.markers:
            marker = mapping.marker_of(name)
            for axis in "xyz" if marker else "":
                source = ColumnSource(source=f"{name} {axis.upper()}", unit=self.unit)
                columns[f"{marker}_{axis}_m"] = source
        return msgspec.structs.replace(mapping, columns=columns | mapping.columns)


def capture_header(path: Path, lines: Iterator[str]) -> tuple[CaptureHeader | None, Iterator[str]]:
    """Header of a marker export and the rows below it; None and all lines of any other table."""
    first = next(lines, "")
    cells = _cells(first)
    if cells[0] == "NO_OF_FRAMES":
        header, lines = _qtm(path, cells, lines)
    elif cells[0] == "PathFileType":
        header = _trc(path, lines)
    else:
        return None, itertools.chain([first], lines)
    return header, _rows(header, lines)


def _qtm(path: Path, cells: list[str], lines: Iterator[str]) -> tuple[CaptureHeader, Iterator[str]]:
    facts: dict[str, list[str]] = {}
    line = ""
    while _KEY.fullmatch(cells[0]) and len(facts) < _MOST_FACTS:
        facts[cells[0]] = cells[1:]
        line = next(lines, "")
        cells = _cells(line)
    names = _names(path, facts.get("MARKER_NAMES", []))
    if not names:
        raise InputError(path, "is a QTM export without MARKER_NAMES", "export labelled 3D data")
    if cells[0] == "Frame":
        return CaptureHeader(names, "mm", len(facts) + 1), lines
    rate_hz = None
    if len(cells) == 3 * len(names):  # positions only
        try:
            rate_hz = float(facts["FREQUENCY"][0])
        except (LookupError, ValueError):
            rate_hz = 0.0
        if not 0 < rate_hz < math.inf:
            what = "has neither times nor FREQUENCY"
            raise InputError(path, what, "export it with its time data")
    return CaptureHeader(names, "mm", len(facts), rate_hz), itertools.chain([line], lines)


def _trc(path: Path, lines: Iterator[str]) -> CaptureHeader:
    keys, values, named, _ = (_cells(next(lines, "")) for _ in range(4))
    names = _names(path, named[2:])
    if named[0] != "Frame#" or not names:
        raise InputError(path, "is a TRC file without names of markers", "export it again")
    facts = dict(zip(keys, values, strict=False))
    return CaptureHeader(names, facts.get("Units") or "mm", 5)


def _names(path: Path, cells: list[str]) -> tuple[str, ...]:
    names = tuple(filter(None, cells))
    if 3 * len(names) > MOST_COLUMNS:
        what = f"has {len(names)} markers, more than {MOST_COLUMNS // 3}"
        raise InputError(path, what, "leave out what is not needed")
    return names


def _rows(header: CaptureHeader, lines: Iterator[str]) -> Iterator[str]:
    """Rows that are not blank, with a time where they have none."""
    filled = (line for line in lines if line.strip())
    for number, line in enumerate(filled):
        if header.rate_hz is None:
            yield line
        else:
            yield f"{number + 1}\t{number / header.rate_hz!r}\t{line}"


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.rstrip("\r\n").split("\t")]
