"""Reader of tables (CSV, TSV, JSON, MATLAB) whose columns a map renames to those of a trial.

The map defines what the columns mean, so the log of another plant needs another map but no other
reader. Text may also be a marker export of QTM or TRC. In JSON a map may name paths:
`samples[].motor.position` is one value of every entry of a list, `channels.force` a whole list.
`[]` (in a pointer: `*`) stands for every entry of a list, `[2]` for the third one::

    samples[].motor.position      /samples/*/motor/position
    samples[].force[0]            /samples/*/force/0
    rig.load.force                /rig/load/force

A pointer follows RFC 6901 (`~1` is a slash, `~0` a tilde) except for the `*`.
"""

from __future__ import annotations

import io
import itertools
import math
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import MOST_CELLS, read_bytes, read_json, read_lines
from firmware_py.core.signals import TIME, unit_of
from models.shared.numeric_text import (
    MOST_COLUMNS,
    check_columns,
    not_a_number,
    read_header,
    read_numbers,
)
from models.trials.recordings.mapping import ColumnSource, RecordingMap, Scalar
from models.trials.recordings.series import Series
from models.trials.trial import Array

Columns = dict[str, Any]
"""Cells by the name of their column, each a sequence or an array of length n."""


def read_table(path: Path, mapping: RecordingMap) -> list[Series]:
    """Read the columns of a table that the map names, in SI units.

    A column that the map does not name is used if its name ends in a unit suffix; all others
    are dropped. A marker export (QTM, TRC) needs `[markers]` only.
    """
    if path.suffix.lower() == ".json":
        raw = _json_columns(path, mapping)
    elif path.suffix.lower() == ".mat":
        raw = _most_frequent_length(_matlab_columns(path))
    else:
        raw, mapping = _text_columns(path, mapping)
    if not raw:
        remedy = "export a header and one row per sample, or map paths"
        raise InputError(path, "holds no columns", remedy)
    _check_lengths(path, [c.source for c in mapping.columns.values()], raw)
    columns = {
        name: _numbers(path, name, cells)
        for name, cells in raw.items()
        if _has_meaning(name, mapping)
    }
    for name, column in mapping.columns.items():
        if column.source not in raw:
            what = f"column {column.source!r} (mapped to {name}) is missing"
            raise _wrong_map(path, what, raw, mapping, "correct 'from'")
        declared = mapping.signals[name].unit if name in mapping.signals else unit_of(name)
        numbers = _numbers(path, column.source, raw[column.source])
        columns[name] = column.to_si(mapping.path, name, numbers, declared, unit_of(column.source))
    if TIME.name not in columns:
        remedy = 'add time_s = { from = "…", unit = "s" }'
        raise _wrong_map(path, "no column is mapped to time_s", raw, mapping, remedy)
    return [Series(columns.pop(TIME.name), columns, path)]


def read_scalars(path: Path) -> dict[str, Scalar]:
    """Single values of a file beside its columns, by name: a gain, a mass, the motion's name.

    In JSON these are the strings and numbers of an object, and those of objects in it by dotted
    path and by JSON pointer; in a MATLAB file, the 1 × 1 variables. Other files have none.
    """
    if path.suffix.lower() == ".json":
        return _single_values(read_json(path, "export it again"))
    if path.suffix.lower() == ".mat":
        single = {n: np.ravel(v)[0] for n, v in matlab_variables(path).items() if np.size(v) == 1}
        plain = {n: v.item() if isinstance(v, np.generic) else v for n, v in single.items()}
        return {n: v for n, v in plain.items() if isinstance(v, str | int | float)}
    return {}


def _has_meaning(name: str, mapping: RecordingMap) -> bool:
    """Whether a column is a signal by its name in the file."""
    return unit_of(name) is not None and name not in mapping.columns


def _wrong_map(
    path: Path, what: str, raw: Columns, mapping: RecordingMap, remedy: str
) -> InputError:
    """Error of a map that does not fit a table; it says which table of the map was used."""
    other = "[servo_columns]" if mapping.table == "[columns]" else "[columns]"
    file = "that of --servo" if mapping.table == "[columns]" else "the recording itself"
    return InputError(
        path,
        f"{what}; it has " + ", ".join(map(repr, list(raw)[:20])),
        f"{remedy} under {mapping.table} in MAP.toml; {other} is for {file}",
    )


def _numbers(path: Path, name: str, cells: Sequence[Any]) -> Array:
    """Cells as doubles; NaN for an empty one."""
    if isinstance(cells, np.ndarray):
        return np.asarray(cells, dtype=np.float64)
    numbers = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            numbers[i] = np.nan if cell is None or cell == "" else float(cell)
        except (TypeError, ValueError, OverflowError):
            raise not_a_number(path, f"sample {i + 1}, column {name!r}", cell) from None
    return numbers


def _check_lengths(path: Path, sources: Sequence[str], raw: Columns) -> None:
    """Refuse mapped columns that were not sampled together."""
    lengths = {name: len(raw[name]) for name in sorted(sources) if name in raw}
    if len(set(lengths.values())) > 1:
        shortest, longest = (of(lengths, key=lengths.__getitem__) for of in (min, max))
        raise InputError(
            path,
            f"{shortest!r} has {lengths[shortest]} values, {longest!r} has {lengths[longest]}",
            "map columns that were sampled together",
        )


def _most_frequent_length(columns: dict[str, Any]) -> Columns:
    lengths = [len(v) for v in columns.values()]
    commonest = max(set(lengths), key=lambda n: (lengths.count(n), n), default=0)
    return {k: v for k, v in columns.items() if len(v) == commonest}


# --- text ------------------------------------------------------------------------------------


def _text_columns(path: Path, mapping: RecordingMap) -> tuple[Columns, RecordingMap]:
    """Columns of a text table, and the map with what a marker export says of itself.

    A column without use is empty, whatever its cells hold. The most frequent character of `,`, `;`
    and tabulator in the header is the separator.
    """
    lines = read_lines(path, "name an existing table")
    first, above = next(lines, ""), 1
    delimiter = max(",;\t", key=first.count)
    if export := _export_header(path, _cells(first), lines):
        mapping = export.complete(mapping)
        header, delimiter, above = export.columns, "\t", export.rows
        lines = export.rows_below(lines)
        check_columns(path, header)
    else:
        header = read_header(path, first, delimiter)
    sources = {column.source for column in mapping.columns.values()}
    used = [k for k, name in enumerate(header) if name in sources or _has_meaning(name, mapping)]
    samples = read_numbers(path, lines, header, used, delimiter, above)
    columns: Columns = {name: np.zeros(0) for name in header}
    return columns | {header[k]: samples[:, i] for i, k in enumerate(used)}, mapping


# --- marker exports as text: QTM's TSV, and the TRC of OpenSim and other programs -----------------
#
# Both are tables below rows of metadata. QTM writes `KEY<tab>value`, with the names in
# `MARKER_NAMES`, and may omit the columns `Frame` and `Time` and their header row. TRC has five
# header rows, with a name over every third column.

_KEY: Final = re.compile(r"[A-Z_]+")
_MOST_FACTS: Final = 100
"""Most rows of metadata in QTM's header; it writes ten to twelve."""


class _ExportHeader(NamedTuple):
    """Header of a marker export."""

    markers: tuple[str, ...]  # Names in the file
    unit: str  # Unit of length
    rows: int  # Number of header rows
    read: str = ""  # Row of samples that was read to find the end of the header
    rate_hz: float | None = None  # Rate of rows without a time; None if rows have a time

    @property
    def columns(self) -> list[str]:
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

    def rows_below(self, lines: Iterator[str]) -> Iterator[str]:
        """Rows that are not blank, with a time where they have none."""
        filled = (line for line in itertools.chain([self.read], lines) if line.strip())
        for number, line in enumerate(filled):
            if self.rate_hz is None:
                yield line
            else:
                yield f"{number + 1}\t{number / self.rate_hz!r}\t{line}"


def _export_header(path: Path, first: list[str], lines: Iterator[str]) -> _ExportHeader | None:
    """Header of a marker export; None for any other table."""
    if first[0] == "NO_OF_FRAMES":
        return _qtm(path, first, lines)
    return _trc(path, lines) if first[0] == "PathFileType" else None


def _qtm(path: Path, cells: list[str], lines: Iterator[str]) -> _ExportHeader:
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
        return _ExportHeader(names, "mm", len(facts) + 1)
    rate_hz = None
    if len(cells) == 3 * len(names):  # positions only
        try:
            rate_hz = float(facts["FREQUENCY"][0])
        except (LookupError, ValueError):
            rate_hz = 0.0
        if not 0 < rate_hz < math.inf:
            what = "has neither times nor FREQUENCY"
            raise InputError(path, what, "export it with its time data")
    return _ExportHeader(names, "mm", len(facts), line, rate_hz)


def _trc(path: Path, lines: Iterator[str]) -> _ExportHeader:
    keys, values, named, _ = (_cells(next(lines, "")) for _ in range(4))
    names = _names(path, named[2:])
    if named[0] != "Frame#" or not names:
        raise InputError(path, "is a TRC file without names of markers", "export it again")
    facts = dict(zip(keys, values, strict=False))
    return _ExportHeader(names, facts.get("Units") or "mm", 5)


def _names(path: Path, cells: list[str]) -> tuple[str, ...]:
    names = tuple(filter(None, cells))
    if 3 * len(names) > MOST_COLUMNS:
        what = f"has {len(names)} markers, more than {MOST_COLUMNS // 3}"
        raise InputError(path, what, "leave out what is not needed")
    return names


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.rstrip("\r\n").split("\t")]


# --- JSON ------------------------------------------------------------------------------------

_EVERY: Final = "*"
_TOKEN: Final = re.compile(r"([^.\[\]]+)|\[(\d*)\]")
_LONGEST_NAME: Final = 1000
"""Most characters of a path to a single value."""


def _json_columns(path: Path, mapping: RecordingMap) -> Columns:
    """Columns of a JSON file, with those that the map names by a path.

    The file may be a list of records, an object of equally long lists, or an object with one key
    for the list of records.
    """
    document = records = read_json(path, "export it again")
    columns: Columns = {}
    if isinstance(document, dict):
        lists = {k: v for k, v in document.items() if isinstance(v, list) and v}
        records = next((v for v in lists.values() if isinstance(v[0], dict)), None)
        columns = {} if records else _most_frequent_length(lists)
    if isinstance(records, list) and records and all(isinstance(r, dict) for r in records):
        if len(records[0]) * len(records) > MOST_CELLS:
            raise InputError(path, f"holds more than {MOST_CELLS} values", "divide it")
        columns = {name: [record.get(name) for record in records] for name in records[0]}
    sources = sorted({column.source for column in mapping.columns.values()} - columns.keys())
    nested = [source for source in sources if set(source) & set("./[")]
    return columns | {source: json_values(path, document, source) for source in nested}


def _single_values(node: Any, dotted: str = "", pointer: str = "") -> dict[str, Scalar]:
    """Strings and numbers of an object and of all objects in it, by dotted path and by pointer."""
    values: dict[str, Scalar] = {}
    for name, value in node.items() if isinstance(node, dict) else ():
        names = (f"{dotted}.{name}".removeprefix("."), f"{pointer}/{name}")
        if len(names[1]) > _LONGEST_NAME:
            continue
        if isinstance(value, str | int | float):
            values |= dict.fromkeys(names, value)
        values |= _single_values(value, *names)
    return values


def json_values(where: Path, document: Any, path: str) -> Sequence[Any]:
    """Values at a path; None for an entry of a list that lacks the last names of the path."""
    nodes, every = [document], False
    tokens = _tokens(path)
    for depth, token in enumerate(tokens):
        if token == _EVERY and every:
            what = f"{path!r} passes every entry of two lists"
            raise InputError(where, what, "give one of them a number")
        if token == _EVERY and isinstance(nodes[0], list):
            nodes, every = nodes[0], True
            continue
        below = [_child(node, token) for node in nodes]
        if all(node is None for node in below):
            what = _dead_end(path, nodes[0] if nodes else None, tokens, depth)
            raise InputError(where, what, "correct 'from' in MAP.toml")
        nodes = below
    values = nodes if every else nodes[0]
    if not isinstance(values, list) or any(isinstance(v, dict | list) for v in values):
        raise InputError(
            where, f"{path!r} does not lead to a list of single values",
            "add '[]' where a list has one entry per sample, or the name of a value",
        )  # fmt: skip
    return values


def _tokens(path: str) -> list[str]:
    if path.startswith("/"):
        return [t.replace("~1", "/").replace("~0", "~") for t in path[1:].split("/")]
    return [name or index or _EVERY for name, index in _TOKEN.findall(path)]


def _child(node: Any, token: str) -> Any:
    if isinstance(node, dict):
        return node.get(token)
    if isinstance(node, list) and token.isdigit() and int(token) < len(node):
        return node[int(token)]
    return None


def _dead_end(path: str, node: Any, tokens: list[str], depth: int) -> str:
    """Message that says where a path ends."""
    before = ".".join(tokens[:depth]).replace(f".{_EVERY}", "[]") or "the file"
    has = "it is a single value"
    if isinstance(node, dict):
        has = f"it has {', '.join(map(repr, list(node)[:20])) or 'no names'}"
    elif isinstance(node, list):
        has = f"it is a list of {len(node)}: write '[]' for every entry"
    wanted = "list" if tokens[depth] == _EVERY else repr(tokens[depth])
    return f"{path!r}: {before} holds no {wanted}; {has}"


# --- MATLAB up to version 7 ------------------------------------------------------------------

_MATRIX_COLUMNS: Final = 32
"""Most columns of a matrix whose columns count as channels sampled together."""


def matlab_variables(path: Path) -> dict[str, Any]:
    """Variables of a MATLAB file by name; the child process of an import limits their memory."""
    from scipy.io import loadmat

    data = read_bytes(path, "name an existing MATLAB file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for example of two variables with one name
            variables = loadmat(io.BytesIO(data))
    except MemoryError:
        raise
    except Exception as error:  # scipy passes on any error of its parser
        what = f"is not a MATLAB file up to version 7 ({type(error).__name__}: {error})"
        raise InputError(path, what, "save it with -v7") from None
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def _matlab_columns(path: Path) -> dict[str, Any]:
    """Vectors of a MATLAB file, and the columns of its matrices as `name[k]`."""
    columns: dict[str, Any] = {}
    cells = 0
    for name, value in matlab_variables(path).items():
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
            continue
        cells += value.size
        if cells > MOST_CELLS:
            raise InputError(path, f"holds more than {MOST_CELLS} numbers", "divide it")
        if value.size == max(value.shape, default=0) > 1:
            columns[name] = value.ravel()
        elif value.ndim == 2 and 1 < value.shape[1] <= _MATRIX_COLUMNS < len(value):
            columns |= {f"{name}[{k}]": rows for k, rows in enumerate(value.T)}
    return columns
