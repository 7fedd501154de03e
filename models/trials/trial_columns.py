"""Columns of a trial: which are required, and how they are read from CSV and checked."""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS, read_lines
from firmware_py.files.table_end import TableEnd
from firmware_py.signals import TIME, Signal, tip_names, trial_signals, unit_of
from models.trials.trial import Array, SignalRole

PlantSignals = Mapping[str, SignalRole]
"""Signals of a plant by name; empty for the link, whose columns the contract defines."""

MOST_COLUMNS: Final = 1000
"""Most columns of a table [assumed]; a trial of the link has 62 with 16 markers."""
FEWEST_ROWS: Final = 3
"""Fewest rows of a trial: a velocity needs two, an acceleration three."""
STEP_RANGE_S: Final = (5e-5, 0.5)
"""Shortest and longest time step: the motion is below 4 Hz, the fastest analogue channels have a
few kilohertz."""
_MARKER = re.compile(r"m\d\d_[xyz]_m")
_COLUMN_RANGE: Final = {"rad": (6.3, "degrees"), "a": (100.0, "mA"), "m": (100.0, "mm")}
"""Largest plausible magnitude by suffix, and the unit that a larger one suggests."""


def columns_of(dof: int, signals: PlantSignals | None, markers: int) -> tuple[Signal, ...]:
    """Columns that a trial must have; without `signals` of a plant file, those of the link."""
    if not signals:
        return trial_signals(dof, markers)
    rows = [Signal(n, s.unit, s.role) for n, s in signals.items() if s.role != "condition"]
    return (TIME, *rows)


def check_step_range(where: Path | str, field: str, step_s: float) -> None:
    """Refuse a time step that no recording of the link has."""
    low_s, high_s = STEP_RANGE_S
    if low_s <= step_s <= high_s:
        return
    unit = "milliseconds" if step_s > high_s else "another unit"
    raise InputError(
        where, f"{field}: the rows are {step_s:.3g} s apart, outside 0.05 ms to 0.5 s",
        f"give it in s, not in {unit}",
    )  # fmt: skip


def read_sample_columns(path: Path, signals: Sequence[Signal], known: set[str]) -> dict[str, Array]:
    """Read and check the columns of a CSV file."""
    required = [s.name for s in signals]
    try:
        end = TableEnd(read_lines(path, "name an existing trial"))
        reader = csv.reader(end.lines())
        header = next(reader, [])
        if header:
            _check_header(path, header, required, known)
        samples = _read_rows(path, header, reader, required, end)
    except csv.Error as error:
        raise InputError(path, f"is not CSV text ({error})", "export it as UTF-8 CSV") from None
    if len(samples) < FEWEST_ROWS:
        raise InputError(path, f"has {len(samples)} rows", "give at least three")
    columns = {name: np.ascontiguousarray(samples[:, k]) for k, name in enumerate(header)}
    for name in required:
        _check_magnitude(path, name, columns[name])
    return columns


def check_columns(
    where: Path, columns: Mapping[str, Array], signals: Sequence[Signal], known: set[str]
) -> None:
    """Refuse columns, each of shape (n,), that are no samples of a trial."""
    required = [s.name for s in signals]
    _check_header(where, list(columns), required, known)
    for name in required:
        missing = np.flatnonzero(~np.isfinite(columns[name]))
        tip = name in tip_names() and len(missing) == len(columns[name])
        if len(missing) and not (tip or _MARKER.fullmatch(name)):
            raise _no_number(where, int(missing[0]) + 2, name, str(columns[name][missing[0]]))
        _check_magnitude(where, name, columns[name])


def _read_rows(
    path: Path, header: list[str], reader: Iterator[list[str]], required: Sequence[str],
    end: TableEnd,
) -> Array:  # fmt: skip
    """Samples, shape (n, columns); read row by row, because the text takes ten times the memory."""
    optional = [bool(_MARKER.fullmatch(h)) or h not in required for h in header]
    tip = {k for k, name in enumerate(header) if name in tip_names()}
    numbers, count, blank = array("d"), 0, False
    tip_seen, tip_empty = False, (0, 0)
    for row in reader:
        if not row:  # blank lines at the end are no samples
            blank = True
            continue
        count += 1
        if count * len(header) > MOST_CELLS:
            raise InputError(path, f"holds more than {MOST_CELLS} numbers", "divide the trial")
        if blank or len(row) != len(header):
            raise InputError(
                path,
                f"row {count + 1} has {0 if blank else len(row)} cells, the header {len(header)}",
                "the file is truncated or damaged: export it again",
            )
        values = _numbers(row)
        missing = () if math.isfinite(sum(values)) else range(len(row))
        for k in (k for k in missing if not math.isfinite(values[k])):
            if row[k] == "" and k in tip:  # all cells of the tip may be empty, or none
                tip_empty = tip_empty if tip_empty[0] else (count + 1, k)
            elif row[k] or not optional[k]:
                raise _no_number(path, count + 1, header[k], row[k])
        tip_seen = tip_seen or any(row[k] for k in tip)
        end.see(row[-1])
        numbers.extend(values)
    end.refuse_cut(path, count + 1, header[-1] if header else "")
    if tip_seen and tip_empty[0]:
        raise _no_number(path, tip_empty[0], header[tip_empty[1]], "")
    return np.frombuffer(numbers, dtype=np.float64).reshape(count, -1 if count else 0)


def _numbers(row: list[str]) -> list[float]:
    """Cells as numbers, NaN if they are none; `float` would read 0.0_17 as 0.017."""
    try:
        if "_" not in "".join(row):
            return [float(cell) for cell in row]
        return [_number(cell) for cell in row]
    except ValueError:
        return [_number(cell) for cell in row]


def _number(cell: str) -> float:
    try:
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan


def _no_number(path: Path, row: int, column: str, cell: str) -> InputError:
    return InputError(
        path, f"row {row}, column {column}: {cell!r} is not a finite number",
        "correct the cell (only a marker may be empty, where it was occluded)",
    )  # fmt: skip


def _check_header(path: Path, header: list[str], required: list[str], known: set[str]) -> None:
    if len(header) > MOST_COLUMNS:
        what = f"has {len(header)} columns, more than {MOST_COLUMNS}"
        raise InputError(path, what, "leave out what is not needed")
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


def _column_remedy(name: str, header: Sequence[str]) -> str:
    stem = name.rsplit("_", 1)[0]
    alike = [h for h in header if h.rsplit("_", 1)[0] == stem or h == stem]
    if alike:
        return f"convert column {alike[0]!r} to the SI unit and call it {name}"
    return "add it, or use 'dropstitch import' to map your columns"


def _check_magnitude(path: Path, name: str, column: Array) -> None:
    limit, suspect = _COLUMN_RANGE.get(name.rpartition("_")[2], (np.inf, ""))
    beyond = np.flatnonzero(np.abs(column) > limit)
    if len(beyond):
        raise InputError(
            path, f"row {beyond[0] + 2}, column {name}: {column[beyond[0]]:g} is not plausible",
            f"convert it if it is in {suspect}",
        )  # fmt: skip
