"""End of a text table: whether the file was cut off in the middle of its last number."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from firmware_py.errors import InputError

__all__ = ["TableEnd"]

_NUMBER: Final = re.compile(r"[-+]?(\d*)(?:[.,](\d*))?(?:[eE]([-+]?\d+))?")
FEWEST_ROWS: Final = 20
"""Rows above the last one: in fewer its number may have the fewest decimals by chance [assumed]."""


class TableEnd:
    r"""Watch on the lines of a table and on the last cell of each row.

    Many programs write no line break behind the last row: that alone says nothing. A number with
    fewer decimals than every other one of its column, of which there are some, or with an exponent
    of one digit, does. What a cut costs beside these is the last digit of one number.
    """

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines, self._ended, self._last = lines, True, ""
        self._fewest: int | None = None
        self._rows = 0

    def lines(self) -> Iterator[str]:
        """Lines of the file, as they are."""
        for line in self._lines:
            self._ended = line.endswith(("\n", "\r"))
            yield line

    def see(self, cell: str) -> None:
        """Note the last cell of a row."""
        self._rows += 1
        before = _decimals(self._last)
        if before is not None:
            self._fewest = before if self._fewest is None else min(self._fewest, before)
        self._last = cell

    @property
    def is_cut(self) -> bool:
        """Whether the file ends within its last number, as far as that can be told."""
        decimals = _decimals(self._last)
        if self._ended or decimals is None or self._fewest is None or self._rows <= FEWEST_ROWS:
            return False
        digits = self._last.strip().lower().partition("e")[2].lstrip("+-")
        return len(digits) == 1 or decimals < self._fewest

    def refuse_cut(self, path: Path, row: int, column: str) -> None:
        """Refuse a file that ends within its last number."""
        if self.is_cut:
            raise InputError(
                path,
                f"row {row}, column {column}: the file ends within {self._last.strip()[:80]!r}, "
                "which has fewer digits than all numbers above it",
                "copy or export it again, or end the last row with a line break if it is whole",
            )


def _decimals(cell: str) -> int | None:
    """Decimals of a number, an exponent counted in; None for a zero and for what is no number."""
    parts = _NUMBER.fullmatch(cell.strip())
    if parts is None or not (parts[1] + (parts[2] or "")).strip("0"):
        return None
    return len(parts[2] or "") - int((parts[3] or "0")[:5])
