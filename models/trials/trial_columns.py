"""Columns of a trial: which there must be, and their reading and checking from a CSV file."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from firmware_py.signals import TIME, Signal, tip_names, trial_signals, unit_of
from models.trials.trial import Array, SignalRole

PlantSignals = Mapping[str, SignalRole]
"""Signals of a plant by name; empty for the link, whose columns the contract defines."""

_MARKER = re.compile(r"m\d\d_[xyz]_m")
_COLUMN_RANGE: Final = {"rad": (6.3, "degrees"), "a": (100.0, "mA"), "m": (100.0, "mm")}
"""Largest plausible magnitude by suffix, and the unit that a larger one suggests."""


def columns_of(dof: int, signals: PlantSignals | None) -> tuple[Signal, ...]:
    """Columns that a trial must have.

    Parameters
    ----------
    dof : int
        Joints of a trial of the link.
    signals : mapping of str to SignalRole or None
        Signals that a plant's file declares; None or empty for the link.
    """
    if not signals:
        return trial_signals(dof)
    rows = [Signal(n, s.unit, s.role) for n, s in signals.items() if s.role != "condition"]
    return (TIME, *rows)


def read_sample_columns(path: Path, signals: Sequence[Signal], known: set[str]) -> dict[str, Array]:
    """Columns of a CSV file by name.

    Parameters
    ----------
    path : Path
        CSV file.
    signals : sequence of Signal
        Columns that must be there.
    known : set of str
        Names that need no unit suffix.

    Raises
    ------
    InputError
        If the file is truncated or no CSV, a column is missing, doubled or without a unit, or a
        value is not a plausible finite number where one is required.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"is not CSV text ({error})", "export it as UTF-8 CSV") from None
    while rows and not rows[-1]:  # blank lines at the end are no samples
        rows.pop()
    if len(rows) < 4:
        raise InputError(path, f"has {max(len(rows) - 1, 0)} rows", "give at least three")
    header, body = rows[0], rows[1:]
    required = [s.name for s in signals]
    _check_header(path, header, required, known)
    samples = np.full((len(body), len(header)), np.nan)
    optional = _optional(header, body, required)
    for i, row in enumerate(body):
        if len(row) != len(header):
            raise InputError(
                path, f"row {i + 2} has {len(row)} cells, the header {len(header)}",
                "the file is truncated or damaged: export it again",
            )  # fmt: skip
        for k, cell in enumerate(row):
            if cell == "" and header[k] in optional:
                continue
            try:
                samples[i, k] = float(cell)
            except ValueError:
                samples[i, k] = np.nan
            if not np.isfinite(samples[i, k]):
                raise InputError(
                    path, f"row {i + 2}, column {header[k]}: {cell!r} is not a finite number",
                    "correct the cell (only a marker may be empty, where it was occluded)",
                )  # fmt: skip
    columns = {name: np.ascontiguousarray(samples[:, k]) for k, name in enumerate(header)}
    for name in required:
        _check_magnitude(path, name, columns[name])
    return columns


def _check_header(path: Path, header: list[str], required: list[str], known: set[str]) -> None:
    for name in required:
        if name not in header:
            raise InputError(path, f"column {name} is missing", _column_remedy(name, header))
    for name in header:
        if header.count(name) > 1:
            raise InputError(path, f"column {name!r} stands twice", "remove one of the two")
        if name not in required and name not in known and unit_of(name) is None:
            raise InputError(
                path, f"column {name!r} has no unit suffix", "name it like temperature_1_degc"
            )


def _optional(header: list[str], body: list[list[str]], required: list[str]) -> set[str]:
    """Columns whose cells may be empty; those of the tip only where all of them are."""
    names = {h for h in header if _MARKER.fullmatch(h) or h not in required}
    tip = [header.index(name) for name in tip_names() if name in header]
    unseen = not any(row[k] for row in body for k in tip if k < len(row))
    return names | set(tip_names()) if unseen else names


def _column_remedy(name: str, header: Sequence[str]) -> str:
    stem = name.rsplit("_", 1)[0]
    alike = [h for h in header if h.rsplit("_", 1)[0] == stem or h == stem]
    if alike:
        return f"convert column {alike[0]!r} to the SI unit and call it {name}"
    return "add it, or use 'python -m models import' to map your columns"


def _check_magnitude(path: Path, name: str, column: Array) -> None:
    limit, suspect = _COLUMN_RANGE.get(name.rsplit("_", 1)[1], (np.inf, ""))
    beyond = np.flatnonzero(np.abs(column) > limit)
    if len(beyond):
        raise InputError(
            path, f"row {beyond[0] + 2}, column {name}: {column[beyond[0]]:g} is not plausible",
            f"convert it if it is in {suspect}",
        )  # fmt: skip
