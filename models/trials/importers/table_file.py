"""Reader of tables (CSV, TSV, JSON, MATLAB) whose columns a map renames to the contract's names.

`read_columns` returns all columns of a file. The map gives them their meaning, so that the log of
another plant needs another map but no other reader. In JSON a map may also give a path
(`models.trials.importers.json_path`).
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.errors import InputError
from firmware_py.signals import TIME, unit_of
from models.trials.importers.json_path import json_values
from models.trials.importers.mapping import RecordingMap, Scalar
from models.trials.importers.series import Series, factor_to_si
from models.trials.trial import Array

MATRIX_COLUMNS: Final = 32
"""Most columns of a matrix of a MATLAB file that are taken for channels sampled together."""


def read_table(path: Path, mapping: RecordingMap) -> list[Series]:
    """Columns of a table by the contract's names, in SI units.

    A column that the map does not name is kept if its own name ends in a unit suffix of the
    contract; all others are dropped.

    Parameters
    ----------
    path : Path
        CSV, TSV, JSON or MATLAB file.
    mapping : RecordingMap
        With `[columns]`.

    Raises
    ------
    InputError
        If the file cannot be read, a mapped column is missing, a cell is not a number, or nothing
        is mapped to `time_s`.
    """
    raw = _with_paths(path, mapping, read_columns(path, may_be_nested=_is_json(path)))
    columns = {
        name: _numbers(path, name, cells)
        for name, cells in raw.items()
        if unit_of(name) is not None and name not in mapping.columns
    }
    for name, column in mapping.columns.items():
        if column.source not in raw:
            raise InputError(
                path,
                f"column {column.source!r} (mapped to {name}) is missing; it has "
                + ", ".join(map(repr, list(raw)[:20])),
                "correct 'from' in MAP.toml",
            )
        declared = mapping.signals[name].unit if name in mapping.signals else unit_of(name)
        unit = column.unit or unit_of(column.source) or declared or "1"
        factor = column.scale * factor_to_si(Path(mapping.path), name, unit, declared)
        columns[name] = _numbers(path, column.source, raw[column.source]) * factor + column.offset
    if TIME.name not in columns:
        raise InputError(
            path,
            "no column is mapped to time_s; it has " + ", ".join(map(repr, list(raw)[:20])),
            'add time_s = { from = "…", unit = "s" } under [columns] in MAP.toml',
        )
    return [Series(columns.pop(TIME.name), columns, path)]


def _with_paths(
    path: Path, mapping: RecordingMap, raw: dict[str, Sequence[Any]]
) -> dict[str, Sequence[Any]]:
    """Columns of a file, and those that the map names by a path into nested JSON."""
    wanted = {c.source for c in mapping.columns.values()}
    nested = sorted(w for w in wanted - set(raw) if set(w) & set("./[")) if _is_json(path) else []
    if not nested and not raw:
        raise InputError(
            path, "holds no columns", "export a header and one row per sample, or map paths"
        )
    document = _json(path) if nested else None
    raw = raw | {source: json_values(path, document, source) for source in nested}
    lengths = {w: len(raw[w]) for w in sorted(wanted & set(raw))}
    if len(set(lengths.values())) > 1:
        shortest, longest = (
            min(lengths, key=lengths.__getitem__),
            max(lengths, key=lengths.__getitem__),
        )
        raise InputError(
            path,
            f"{shortest!r} has {lengths[shortest]} values, {longest!r} has {lengths[longest]}",
            "map columns that were sampled together",
        )
    return raw


def _is_json(path: Path) -> bool:
    return path.suffix.lower() == ".json"


def read_scalars(path: Path) -> dict[str, Scalar]:
    """Single values of a file beside its columns, by name: a gain, a mass, the motion's name.

    These are the strings and numbers of a JSON object, those of objects in it by dotted path and by
    JSON pointer, and the 1 × 1 variables of a MATLAB file; other files have none.

    Raises
    ------
    InputError
        If the file cannot be read as what its suffix says.
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        dotted = _single_values(_json(path), "{}.{}")
        return {n.removeprefix("."): v for n, v in dotted.items()} | _single_values(
            _json(path), "{}/{}"
        )
    if suffix == ".mat":
        return {n: np.ravel(v)[0].item() for n, v in _matlab(path).items() if np.size(v) == 1}
    return {}


def _single_values(node: Any, form: str, prefix: str = "") -> dict[str, Scalar]:
    """Strings and numbers of an object and of all objects in it, by path."""
    result: dict[str, Scalar] = {}
    for name, value in node.items() if isinstance(node, dict) else ():
        own = form.format(prefix, name)
        if isinstance(value, str | int | float):
            result[own] = value
        result |= _single_values(value, form, own)
    return result


def read_columns(path: Path, *, may_be_nested: bool = False) -> dict[str, Sequence[Any]]:
    """Cells of a file by the names of its columns, each of length n.

    JSON may be a list of records, an object of equally long lists, or an object in which one key
    holds the list of records. From a MATLAB file the vectors of the most frequent length are taken,
    and the columns of matrices of that length: `speed[0]`, `speed[1]`, ….

    Parameters
    ----------
    path : Path
        The file.
    may_be_nested : bool
        Whether a file without columns is accepted, because a map has paths into it.

    Raises
    ------
    InputError
        If the file cannot be read as what its suffix says.
    """
    suffix = path.suffix.lower()
    try:
        if suffix == ".json":
            columns = _json_columns(_json(path))
        elif suffix == ".mat":
            columns = _matlab_columns(path)
        else:
            columns = _text_columns(path)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            path, f"cannot be read as {suffix or 'text'} ({error})", "export it again"
        ) from None
    if not columns and not may_be_nested:
        raise InputError(path, "holds no columns", "export a header and one row per sample")
    return columns


def _text_columns(path: Path) -> dict[str, Sequence[Any]]:
    text = path.read_text(encoding="utf-8-sig")
    first = text.partition("\n")[0]
    delimiter = max(",;\t", key=first.count)
    rows = [row for row in csv.reader(text.splitlines(), delimiter=delimiter) if row]
    for number, row in enumerate(rows, start=1):
        if len(row) != len(rows[0]):
            raise InputError(
                path,
                f"row {number} has {len(row)} cells, the header {len(rows[0])}",
                "the file is truncated or damaged: export it again",
            )
    header, body = (rows[0], rows[1:]) if rows else ([], [])
    return {name.strip(): [row[k] for row in body] for k, name in enumerate(header)}


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"cannot be read as .json ({error})", "export it again") from None


def _json_columns(document: Any) -> dict[str, Sequence[Any]]:
    if isinstance(document, dict):
        lists = {k: v for k, v in document.items() if isinstance(v, list) and v}
        records = [v for v in lists.values() if isinstance(v[0], dict)]
        if not records:
            return _most_frequent_length(lists)
        document = records[0]
    if not isinstance(document, list) or not all(isinstance(r, dict) for r in document):
        return {}
    return {name: [record.get(name) for record in document] for name in (document or [{}])[0]}


def _matlab(path: Path) -> dict[str, Any]:
    """Variables of a MATLAB file."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        variables = loadmat(path)
    except (MatReadError, NotImplementedError, ValueError, TypeError, OSError) as error:
        raise InputError(
            path, f"is not a MATLAB file up to version 7 ({error})", "save it with -v7"
        ) from None
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def _matlab_columns(path: Path) -> dict[str, Sequence[Any]]:
    columns: dict[str, Sequence[Any]] = {}
    for name, value in _matlab(path).items():
        if np.size(value) == max(np.shape(value), default=0) > 1:
            columns[name] = np.asarray(value).ravel().tolist()
        elif np.ndim(value) == 2 and 1 < np.shape(value)[1] <= MATRIX_COLUMNS < len(value):
            columns |= {f"{name}[{k}]": rows.tolist() for k, rows in enumerate(np.transpose(value))}
    return _most_frequent_length(columns)


def _most_frequent_length(columns: dict[str, Any]) -> dict[str, Sequence[Any]]:
    lengths = [len(v) for v in columns.values()]
    commonest = max(set(lengths), key=lambda n: (lengths.count(n), n), default=0)
    return {k: v for k, v in columns.items() if len(v) == commonest}


def _numbers(path: Path, name: str, cells: Sequence[Any]) -> Array:
    """Cells as doubles; an empty one is NaN."""
    numbers = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            numbers[i] = np.nan if cell is None or cell == "" else float(cell)
        except (TypeError, ValueError):
            raise InputError(
                path,
                f"sample {i + 1}, column {name!r}: {cell!r} is not a number",
                "correct the cell or leave it empty",
            ) from None
    return numbers
