"""Numbers in delimited text: the one reader of trials, tables, Motive's exports and lists of takes.

All of them have the same limits and refuse the same faults in the same sentences: a row of another
length, a cell that is no number, a decimal comma, a file that ends within its last number.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import MOST_CELLS

Array = NDArray[np.float64]

MOST_COLUMNS: Final = 1000
"""Most columns of a table [assumed]; a trial of the link has 62 with 16 markers."""
_DECIMAL_COMMA: Final = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_SPLIT_NUMBER: Final = re.compile(r"(^|,)\s*[-+]?\d+,\d+(,|$)")
"""Two cells that a decimal comma made of one number: neither has a decimal point."""
_TIME_STAMP: Final = re.compile(r"(\d{4}-\d\d-\d\d([T ].*)?)|(\d{1,2}:\d\d(:.*)?)")


def read_header(path: Path, line: str, delimiter: str = ",") -> list[str]:
    """Names of the columns in a table's header line."""
    header = [name.strip() for _, row in _rows(path, iter([line]), delimiter, 0) for name in row]
    check_columns(path, header)
    return header


def check_columns(path: Path, names: Sequence[str]) -> None:
    """Refuse too many columns, or two of one name; names may be empty."""
    if len(names) > MOST_COLUMNS:
        what = f"has {len(names)} columns, more than {MOST_COLUMNS}"
        raise InputError(path, what, "leave out what is not needed")
    for name, count in Counter(filter(None, names)).items():
        if count > 1:
            raise InputError(path, f"column {name!r} stands twice", "rename or remove one of them")


def read_rows(
    path: Path, lines: Iterator[str], header: Sequence[str], delimiter: str = ",", above: int = 1
) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of every row below a header, each as long as the header.

    Blank lines, and empty cells behind the last column, are skipped. The first row has the number
    `above` + 1.
    """
    for number, row in _rows(path, lines, delimiter, above):
        while len(row) > len(header) and not row[-1].strip():
            row.pop()
        if len(row) != len(header):
            what = f"row {number} has {len(row)} cells, the header {len(header)}"
            raise InputError(path, what, _cells_remedy(row, len(header), delimiter))
        yield number, row


def read_numbers(
    path: Path,
    lines: Iterator[str],
    header: Sequence[str],
    used: Sequence[int],
    delimiter: str = ",",
    above: int = 1,
) -> Array:
    """Numbers in the columns `used` of the rows below a header, shape (n, len(used)).

    An empty cell is NaN. Other columns may hold anything.
    """
    numbers, number = array("d"), above
    end = _TableEnd(lines)
    for number, row in read_rows(path, end, header, delimiter, above):
        if len(numbers) > MOST_CELLS:
            raise InputError(path, f"holds more than {MOST_CELLS} numbers", "divide it")
        end.take(row[-1].strip())
        cells = [row[k] for k in used]
        try:
            values = [float(cell or "nan") for cell in cells]
        except ValueError:
            values = [math.inf]
        # `float` reads 0.0_17 as 0.017.
        if math.inf in values or -math.inf in values or "_" in "".join(cells):
            raise _first_fault(path, number, [header[k] for k in used], cells)
        numbers.extend(values)
    if len(header) - 1 in used and end.is_cut:
        raise InputError(
            path,
            f"row {number}, column {header[-1]!r}: the file ends within {end.last[:80]!r}, which "
            "has fewer digits than all numbers above it",
            "copy or export it again, or end the last row with a line break if it is whole",
        )
    return np.frombuffer(numbers, np.float64).reshape(-1 if used else 0, len(used))


def not_a_number(path: Path, place: str, cell: object) -> InputError:
    """Error of a cell that is no number; `place` says which, like "row 3, column 'pos'"."""
    text = str(cell).strip()
    remedy = "correct the cell or leave it empty"
    if _DECIMAL_COMMA.fullmatch(text):
        remedy = "the file has decimal commas: export it with decimal points"
    elif _TIME_STAMP.fullmatch(text):
        remedy = "convert time stamps to seconds"
    return InputError(path, f"{place}: {str(cell)[:80]!r} is not a number", remedy)


def _rows(
    path: Path, lines: Iterator[str], delimiter: str, above: int
) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of every line that is not blank."""
    reader = csv.reader(lines, delimiter=delimiter)
    try:
        for row in reader:
            if row:
                yield above + reader.line_num, row
    except csv.Error as error:
        raise InputError(path, f"is not CSV text ({error})", "export it again") from None


def _cells_remedy(row: Sequence[str], width: int, delimiter: str) -> str:
    if len(row) < width:
        return "the file is truncated or damaged: export it again"
    if len(row) >= 1.5 * width and delimiter == "," and _SPLIT_NUMBER.search(",".join(row)):
        return "it seems to have decimal commas: export it with decimal points"
    return "remove rows that stand above the header, or export it again"


def _first_fault(path: Path, number: int, names: Sequence[str], cells: Sequence[str]) -> InputError:
    """Error of the first cell in a row that is no finite number."""
    for name, cell in zip(names, cells, strict=True):
        place, text = f"row {number}, column {name!r}", cell.strip().lower().lstrip("+-")
        try:
            value = math.nan if "_" in cell else float(cell or 0)
        except ValueError:
            value = math.nan
        if math.isinf(value):
            what = f"{place}: {cell[:80]!r} is not a finite number"
            return InputError(path, what, "correct the cell or leave it empty")
        if math.isnan(value) and text != "nan":
            return not_a_number(path, place, cell)
    raise AssertionError("every cell is a number")


_NUMBER: Final = re.compile(r"[-+]?(\d*)(?:[.,](\d*))?(?:[eE]([-+]?\d+))?")


class _TableEnd(Iterator[str]):
    """Lines of a table, and whether it is truncated within its last number.

    A missing line break after the last row proves nothing, since many programs write none. The file
    counts as truncated if the last number also has fewer decimals than all others of its column, or
    an exponent of one digit. A cut that this test misses costs the last digit of one number. It
    needs more than 20 rows: in fewer, the last number may have the fewest decimals by chance
    [assumed].
    """

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines, self._has_break, self._rows = lines, True, 0
        self.last, self._fewest = "", math.inf

    def __next__(self) -> str:
        line = next(self._lines)
        self._has_break = line.endswith(("\n", "\r"))
        return line

    def take(self, cell: str) -> None:
        """Record the last cell of a row."""
        before = _decimals(self.last)
        self._fewest = self._fewest if before is None else min(self._fewest, before)
        self.last, self._rows = cell, self._rows + 1

    @property
    def is_cut(self) -> bool:
        decimals = _decimals(self.last)
        if self._has_break or decimals is None or self._rows <= 20 or math.isinf(self._fewest):
            return False
        exponent = self.last.lower().partition("e")[2].lstrip("+-")
        return len(exponent) == 1 or decimals < self._fewest


def _decimals(cell: str) -> int | None:
    """Decimals of a number, adjusted by its exponent; None for zero and other text."""
    parts = _NUMBER.fullmatch(cell)
    if parts is None or not (parts[1] + (parts[2] or "")).strip("0"):
        return None
    return len(parts[2] or "") - int((parts[3] or "0")[:5])
