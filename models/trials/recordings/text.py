"""Header of a marker export as text: QTM's TSV, and the TRC of OpenSim and other programs.

Both are tables below rows of metadata. QTM writes `KEY<tab>value`, with the names in
`MARKER_NAMES`, and may omit the columns `Frame` and `Time` and their header row. TRC has five
header rows, with a name over every third column. The columns become `Frame`, `Time`, `NAME X`,
`NAME Y`, `NAME Z`.

Columns of a text table (CSV, TSV), read row by row into doubles.
"""

from __future__ import annotations

import csv
import itertools
import math
import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS, read_lines
from firmware_py.files.table_end import TableEnd
from firmware_py.signals import TIME
from models.trials.files import MOST_COLUMNS
from models.trials.recordings.mapping import ColumnSource, RecordingMap
from models.trials.trial import Array

_KEY: Final = re.compile(r"[A-Z_]+")
_MOST_FACTS: Final = 100
"""Most rows of metadata in QTM's header; it writes ten to twelve."""
_TIMES: Final = ("Frame", "Time")


class CaptureHeader(NamedTuple):
    """Header of a marker export."""

    markers: tuple[str, ...]  # Names in the file
    unit: str  # Unit of length
    rows: int  # Number of header rows
    rate_hz: float | None = None  # Rate of rows without a time; None if rows have a time

    @property
    def columns(self) -> list[str]:
        return [*_TIMES, *(f"{name} {axis}" for name in self.markers for axis in "XYZ")]


def without_capture_header(path: Path, lines: Iterator[str]) -> tuple[Iterator[str], int]:
    """Lines of a table with a single header row, and the number of rows above it.

    Lines of a table that is no marker export are unchanged.
    """
    header, lines = _header(path, lines)
    if header is None:
        return lines, 0
    names = "\t".join(header.columns) + "\n"
    return itertools.chain([names], _rows(header, lines)), header.rows - 1


def with_capture_columns(path: Path, mapping: RecordingMap) -> RecordingMap:
    """Add columns and unit of time and `[markers]` to the map of a marker export.

    The map of any other table is unchanged.
    """
    header, _ = _header(path, read_lines(path, "name an existing table"))
    if header is None:
        return mapping
    columns = {TIME.name: ColumnSource(source="Time", unit="s")}
    for name in header.markers:
        marker = mapping.marker_of(name)
        for axis in "xyz" if marker else "":
            source = ColumnSource(source=f"{name} {axis.upper()}", unit=header.unit)
            columns[f"{marker}_{axis}_m"] = source
    return msgspec.structs.replace(mapping, columns=columns | mapping.columns)


def _header(path: Path, lines: Iterator[str]) -> tuple[CaptureHeader | None, Iterator[str]]:
    """Header of a marker export, or None, and the lines after the header."""
    first = next(lines, "")
    cells = _cells(first)
    if cells[0] == "NO_OF_FRAMES":
        return _qtm(path, cells, lines)
    if cells[0] == "PathFileType":
        return _trc(path, lines), lines
    return None, itertools.chain([first], lines) if first else lines


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
    rows = len(facts)
    if cells[0] == "Frame":
        return CaptureHeader(names, "mm", rows + 1), lines
    lines = itertools.chain([line], lines)
    if len(cells) != 3 * len(names):
        return CaptureHeader(names, "mm", rows), lines
    return CaptureHeader(names, "mm", rows, _rate_hz(path, facts.get("FREQUENCY", []))), lines


def _names(path: Path, cells: list[str]) -> tuple[str, ...]:
    names = tuple(filter(None, cells))
    if 3 * len(names) > MOST_COLUMNS:
        what = f"has {len(names)} markers, more than {MOST_COLUMNS // 3}"
        raise InputError(path, what, "leave out what is not needed")
    return names


def _rate_hz(path: Path, cells: list[str]) -> float:
    try:
        rate_hz = float(cells[0])
    except (IndexError, ValueError):
        rate_hz = 0.0
    if not 0 < rate_hz < float("inf"):
        raise InputError(path, "has neither times nor FREQUENCY", "export it with its time data")
    return rate_hz


def _trc(path: Path, lines: Iterator[str]) -> CaptureHeader:
    keys, values, named, _ = (_cells(next(lines, "")) for _ in range(4))
    names = _names(path, named[2:])
    if named[0] != "Frame#" or not names:
        raise InputError(path, "is a TRC file without names of markers", "export it again")
    facts = dict(zip(keys, values, strict=False))
    return CaptureHeader(names, facts.get("Units") or "mm", 5)


def _rows(header: CaptureHeader, lines: Iterator[str]) -> Iterator[str]:
    """Add the time to rows without one; remove empty cells beyond the header's."""
    width, number = len(header.columns), 0
    for line in lines:
        cells = line.rstrip("\r\n").split("\t")
        if not any(cells):
            continue
        if header.rate_hz is not None:
            cells = [str(number + 1), repr(number / header.rate_hz), *cells]
        while len(cells) > width and not cells[-1].strip():
            cells.pop()
        number += 1
        yield "\t".join(cells) + "\n"


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.rstrip("\r\n").split("\t")]


_SPLIT_NUMBER: Final = re.compile(r"(^|,)\s*[-+]?\d+,\d+(,|$)")
"""Two cells that a decimal comma made of one number: neither has a decimal point."""
_TIME_STAMP: Final = re.compile(r"(\d{4}-\d\d-\d\d([T ].*)?)|(\d{1,2}:\d\d(:.*)?)")
_DECIMAL_COMMA: Final = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")


def read_text_columns(path: Path, wanted: Callable[[str], bool]) -> tuple[list[str], list[Array]]:
    """Read names of all columns of a text table, and the wanted columns as numbers, shape (n,).

    The text has a header; its most frequent character of `,`, `;` and tabulator is the separator.
    The header rows of a marker export (QTM, TRC) are skipped. An empty cell is NaN. A column that
    is not wanted is empty, whatever its cells hold.
    """
    lines, above = without_capture_header(path, read_lines(path, "name an existing table"))
    first = next(lines, "")
    delimiter = max(",;\t", key=first.count)
    header = [name.strip() for name in _split(path, first, delimiter)]
    if len(header) > MOST_COLUMNS:
        what = f"has {len(header)} columns, more than {MOST_COLUMNS}"
        raise InputError(path, what, "leave out what is not needed")
    refuse_doubled(path, header)
    chosen = [k for k, name in enumerate(header) if wanted(name)]
    columns = [array("d") for _ in header]
    number, end = 1, TableEnd(lines)
    try:
        for row in csv.reader(end.lines(), delimiter=delimiter):
            if not row:
                continue
            number += 1
            if len(row) != len(header):
                raise InputError(
                    path, f"row {above + number} has {len(row)} cells, the header {len(header)}",
                    cells_remedy(row, len(header), delimiter),
                )  # fmt: skip
            if number * len(chosen) > MOST_CELLS:
                raise InputError(path, f"holds more than {MOST_CELLS} numbers", "divide it")
            end.see(row[-1])
            for k in chosen:
                columns[k].append(_number(path, number, header[k], row[k]))
    except csv.Error as error:
        raise InputError(path, f"is not CSV text ({error})", "export it again") from None
    if len(header) - 1 in chosen:
        end.refuse_cut(path, above + number, header[-1])
    return header, [np.frombuffer(column, np.float64) for column in columns]


def refuse_doubled(path: Path, names: list[str]) -> None:
    """Refuse two columns of one name; empty names are ignored."""
    seen: set[str] = set()
    for name in names:
        if name and name in seen:
            raise InputError(path, f"column {name!r} stands twice", "rename one of the two")
        seen.add(name)


def cells_remedy(row: Sequence[str], header: int, delimiter: str = ",") -> str:
    """Remedy for a row whose length is not the header's; decimal commas nearly double it."""
    if len(row) < header:
        return "the file is truncated or damaged: export it again"
    if len(row) >= 1.5 * header and delimiter == "," and _SPLIT_NUMBER.search(",".join(row)):
        return "it seems to have decimal commas: export it with decimal points"
    return "remove rows that stand above the header, or export it again"


def has_decimal_comma(cell: object) -> bool:
    """Whether a cell is a number with a decimal comma."""
    return _DECIMAL_COMMA.fullmatch(str(cell).strip()) is not None


def no_number(path: Path, sample: int, column: str, cell: object) -> InputError:
    """Error of a cell that is not a number."""
    remedy = "correct the cell or leave it empty"
    if has_decimal_comma(cell):
        remedy = "the file has decimal commas: export it with decimal points"
    elif _TIME_STAMP.fullmatch(str(cell).strip()):
        remedy = "convert time stamps to seconds"
    return InputError(
        path, f"sample {sample}, column {column!r}: {str(cell)[:80]!r} is not a number", remedy
    )


def _number(path: Path, row: int, column: str, cell: str) -> float:
    """Number in a cell; rows count from 1, the header."""
    try:
        number = float(cell) if cell else math.nan
        if "_" in cell:  # `float` reads 0.0_17 as 0.017
            raise ValueError
    except ValueError:
        raise no_number(path, row - 1, column, cell) from None
    if math.isinf(number):
        what = f"row {row}, column {column!r}: {cell[:80]!r} is not a finite number"
        raise InputError(path, what, "correct the cell or leave it empty")
    return number


def _split(path: Path, line: str, delimiter: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error as error:
        raise InputError(path, f"is not CSV text ({error})", "export it again") from None
