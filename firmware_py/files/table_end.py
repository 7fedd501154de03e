"""Detection of a text table that is truncated within its last number."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from firmware_py.errors import InputError

__all__ = ["TableEnd"]

_NUMBER: Final = re.compile(r"[-+]?(\d*)(?:[.,](\d*))?(?:[eE]([-+]?\d+))?")
FEWEST_ROWS: Final = 20
"""Fewest rows for the test; in fewer, the last number may have the fewest decimals by chance
[assumed]."""


class TableEnd:
    """Observer of the lines of a table and of the last cell of each row.

    A missing line break after the last row proves nothing, since many programs write none. The file
    counts as truncated if the last number also has fewer decimals than all others of its column, or
    an exponent of one digit. A cut that this test misses costs the last digit of one number.
    """

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines, self._ended, self._last = lines, True, ""
        self._fewest: int | None = None
        self._rows = 0

    def lines(self) -> Iterator[str]:
        """Yield the lines of the file unchanged."""
        for line in self._lines:
            self._ended = line.endswith(("\n", "\r"))
            yield line

    def see(self, cell: str) -> None:
        """Record the last cell of a row."""
        self._rows += 1
        before = _decimals(self._last)
        if before is not None:
            self._fewest = before if self._fewest is None else min(self._fewest, before)
        self._last = cell

    @property
    def is_cut(self) -> bool:
        """Whether the file probably ends within its last number."""
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
    """Return the decimals of a number, adjusted by its exponent; None for zero and other text."""
    parts = _NUMBER.fullmatch(cell.strip())
    if parts is None or not (parts[1] + (parts[2] or "")).strip("0"):
        return None
    return len(parts[2] or "") - int((parts[3] or "0")[:5])
