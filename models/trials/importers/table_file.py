"""Reader of tables (CSV, TSV, JSON, MATLAB) whose columns a map renames to those of a trial.

`read_columns` returns all columns of a file. The map defines their meaning, so the log of another
plant needs another map but no other reader. For JSON a map may also have paths
(`models.trials.importers.json_path`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS, read_json
from firmware_py.signals import TIME, unit_of
from models.trials.importers.headers.capture_header import with_capture_columns
from models.trials.importers.json_path import json_values
from models.trials.importers.mapping import RecordingMap, Scalar
from models.trials.importers.matlab_file import matlab_columns, matlab_scalars
from models.trials.importers.series import Series, factor_to_si
from models.trials.importers.text_columns import no_number, read_text_columns
from models.trials.trial import Array

LONGEST_NAME: Final = 1000
"""Most characters of a path to a single value in JSON."""


def read_table(path: Path, mapping: RecordingMap) -> list[Series]:
    """Read the columns of a table that the map names, in SI units.

    A column that the map does not name is kept if its own name ends in a unit suffix; all others
    are dropped. A marker export (QTM, TRC) needs `[markers]` only.
    """
    if path.suffix.lower() not in (".json", ".mat"):
        mapping = with_capture_columns(path, mapping)
    sources = {column.source for column in mapping.columns.values()}

    def kept(name: str) -> bool:
        return unit_of(name) is not None and name not in mapping.columns

    found = read_columns(path, lambda n: n in sources or kept(n), may_be_nested=_is_json(path))
    raw = _with_paths(path, mapping, found)
    columns = {name: _numbers(path, name, cells) for name, cells in raw.items() if kept(name)}
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
    """Columns of a file, with those that the map names by a path into nested JSON."""
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

    In JSON these are the strings and numbers of an object, and those of objects in it by dotted
    path and by JSON pointer; in a MATLAB file, the 1 × 1 variables. Other files have none.
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        document = _json(path)
        dotted = _single_values(document, "{}.{}")
        return {n.removeprefix("."): v for n, v in dotted.items()} | _single_values(
            document, "{}/{}"
        )
    return matlab_scalars(path) if suffix == ".mat" else {}


def _single_values(node: Any, form: str, prefix: str = "") -> dict[str, Scalar]:
    """Strings and numbers of an object and of all objects in it, by path."""
    result: dict[str, Scalar] = {}
    for name, value in node.items() if isinstance(node, dict) else ():
        own = form.format(prefix, name)
        if len(own) > LONGEST_NAME:
            continue
        if isinstance(value, str | int | float):
            result[own] = value
        result |= _single_values(value, form, own)
    return result


def read_columns(
    path: Path, wanted: Callable[[str], bool] = bool, *, may_be_nested: bool = False
) -> dict[str, Sequence[Any]]:
    """Read the cells of a file by the names of its columns, each of length n.

    JSON may be a list of records, an object of equally long lists, or an object with one key for
    the list of records. A MATLAB file yields its vectors of the most frequent length, and the
    columns of matrices of that length: `speed[0]`, `speed[1]`, ….

    `wanted` selects the columns of a text table whose cells are read; others are empty.
    `may_be_nested` accepts a file without columns, because a map has paths into it.
    """
    suffix = path.suffix.lower()
    columns: dict[str, Any]
    if suffix == ".json":
        columns = _json_columns(path, _json(path))
    elif suffix == ".mat":
        columns = _most_frequent_length(matlab_columns(path))
    else:
        names, numbers = read_text_columns(path, wanted)
        columns = dict(zip(names, numbers, strict=True))
    if not columns and not may_be_nested:
        raise InputError(path, "holds no columns", "export a header and one row per sample")
    return columns


def _json(path: Path) -> Any:
    return read_json(path, "export it again")


def _json_columns(path: Path, document: Any) -> dict[str, Sequence[Any]]:
    if isinstance(document, dict):
        lists = {k: v for k, v in document.items() if isinstance(v, list) and v}
        records = [v for v in lists.values() if isinstance(v[0], dict)]
        if not records:
            return _most_frequent_length(lists)
        document = records[0]
    if not isinstance(document, list) or not all(isinstance(r, dict) for r in document):
        return {}
    names = list((document or [{}])[0])
    if len(names) * len(document) > MOST_CELLS:
        raise InputError(path, f"holds more than {MOST_CELLS} values", "divide it")
    return {name: [record.get(name) for record in document] for name in names}


def _most_frequent_length(columns: dict[str, Any]) -> dict[str, Sequence[Any]]:
    lengths = [len(v) for v in columns.values()]
    commonest = max(set(lengths), key=lambda n: (lengths.count(n), n), default=0)
    return {k: v for k, v in columns.items() if len(v) == commonest}


def _numbers(path: Path, name: str, cells: Sequence[Any]) -> Array:
    """Cells as doubles; NaN for an empty one."""
    if isinstance(cells, np.ndarray):
        return np.asarray(cells, dtype=np.float64)
    numbers = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            numbers[i] = np.nan if cell is None or cell == "" else float(cell)
        except (TypeError, ValueError, OverflowError):
            raise no_number(path, i + 1, name, cell) from None
    return numbers
