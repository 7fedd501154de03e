"""Columns of a text table (CSV, TSV), read row by row into doubles."""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS, read_lines
from firmware_py.files.table_end import TableEnd
from models.trials.importers.headers.capture_header import without_capture_header
from models.trials.trial import Array
from models.trials.trial_columns import MOST_COLUMNS

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
