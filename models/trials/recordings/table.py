"""Reader of tables (CSV, TSV, JSON, MATLAB) whose columns a map renames to those of a trial.

The map defines what the columns mean, so the log of another plant needs another map but no other
reader. Text may also be a marker export of QTM or TRC (`capture_header`). In JSON a map may name
paths: `samples[].motor.position` is one value of every entry of a list, `channels.force` a whole
list. `[]` (in a pointer: `*`) stands for every entry of a list, `[2]` for the third one::

    samples[].motor.position      /samples/*/motor/position
    samples[].force[0]            /samples/*/force/0
    rig.load.force                /rig/load/force

A pointer follows RFC 6901 (`~1` is a slash, `~0` a tilde) except for the `*`.
"""

from __future__ import annotations

import io
import re
import warnings
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.display_units import DATA_SIZE
from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS, read_bytes, read_json, read_lines
from firmware_py.signals import TIME, unit_of
from models.shared.numeric_text import check_columns, not_a_number, read_header, read_numbers
from models.trials.recordings.capture_header import CaptureHeader, capture_header
from models.trials.recordings.mapping import RecordingMap, Scalar
from models.trials.recordings.series import Series
from models.trials.trial import Array
from models.trials.units import factor_to_si

Columns = dict[str, Any]
"""Cells by the name of their column, each a sequence or an array of length n."""


def read_table(path: Path, mapping: RecordingMap) -> list[Series]:
    """Read the columns of a table that the map names, in SI units.

    A column that the map does not name is kept if its own name ends in a unit suffix; all others
    are dropped. A marker export (QTM, TRC) needs `[markers]` only.
    """

    def kept(name: str) -> bool:
        return unit_of(name) is not None and name not in mapping.columns

    def wanted(name: str) -> bool:
        return kept(name) or any(name == column.source for column in mapping.columns.values())

    if path.suffix.lower() == ".json":
        raw = _json_with_paths(path, mapping)
    elif path.suffix.lower() == ".mat":
        raw = _most_frequent_length(_matlab_columns(path))
    else:
        lines = read_lines(path, "name an existing table")
        export, lines = capture_header(path, lines)
        mapping = export.complete(mapping) if export else mapping
        raw = _text_columns(path, lines, export, wanted)
    if not raw:
        remedy = "export a header and one row per sample, or map paths"
        raise InputError(path, "holds no columns", remedy)
    _check_lengths(
        path, {c.source: raw[c.source] for c in mapping.columns.values() if c.source in raw}
    )
    columns = {name: _numbers(path, name, cells) for name, cells in raw.items() if kept(name)}
    for name, column in mapping.columns.items():
        if column.source not in raw:
            what = f"column {column.source!r} (mapped to {name}) is missing"
            raise _wrong_map(path, what, raw, mapping, "correct 'from'")
        declared = mapping.signals[name].unit if name in mapping.signals else unit_of(name)
        unit = column.unit or unit_of(column.source) or declared or "1"
        factor = column.scale * factor_to_si(Path(mapping.path), name, unit, declared)
        columns[name] = _numbers(path, column.source, raw[column.source]) * factor + column.offset
    if TIME.name not in columns:
        remedy = 'add time_s = { from = "…", unit = "s" }'
        raise _wrong_map(path, "no column is mapped to time_s", raw, mapping, remedy)
    return [Series(columns.pop(TIME.name), columns, path)]


def _wrong_map(
    path: Path, what: str, raw: Columns, mapping: RecordingMap, remedy: str
) -> InputError:
    """Error of a map that does not fit a table; it says which table of the map was used."""
    what += "; it has " + ", ".join(map(repr, list(raw)[:20]))
    remedy += f" under {mapping.table} in MAP.toml"
    if mapping.table == "[columns]":
        others, other = mapping.servo_columns, "[servo_columns], for the file of --servo"
        remedy += "; [servo_columns] is for the file of --servo"
    else:
        others, other = mapping.recording_columns, "[columns], for the recording itself"
    if any(column.source in raw for column in others.values()):
        remedy = f"its columns stand under {other}: name them under {mapping.table} in MAP.toml"
    return InputError(path, what, remedy)


def read_columns(path: Path) -> Columns:
    """All columns of a table, as they stand in the file.

    JSON may be a list of records, an object of equally long lists, or an object with one key for
    the list of records. A MATLAB file yields its vectors of the most frequent length, and the
    columns of matrices of that length: `speed[0]`, `speed[1]`, ….
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        columns = _json_columns(path, _json(path))
    elif suffix == ".mat":
        columns = _most_frequent_length(_matlab_columns(path))
    else:
        export, lines = capture_header(path, read_lines(path, "name an existing table"))
        columns = _text_columns(path, lines, export, bool)
    if not columns:
        raise InputError(path, "holds no columns", "export a header and one row per sample")
    return columns


def read_scalars(path: Path) -> dict[str, Scalar]:
    """Single values of a file beside its columns, by name: a gain, a mass, the motion's name.

    In JSON these are the strings and numbers of an object, and those of objects in it by dotted
    path and by JSON pointer; in a MATLAB file, the 1 × 1 variables. Other files have none.
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        document = _json(path)
        dotted = _single_values(document, "{}.{}")
        pointers = _single_values(document, "{}/{}")
        return {name.removeprefix("."): value for name, value in dotted.items()} | pointers
    if suffix == ".mat":
        single = {n: np.ravel(v)[0] for n, v in matlab_variables(path).items() if np.size(v) == 1}
        plain = {n: v.item() if isinstance(v, np.generic) else v for n, v in single.items()}
        return {n: v for n, v in plain.items() if isinstance(v, str | int | float)}
    return {}


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


def _check_lengths(path: Path, columns: Columns) -> None:
    """Refuse mapped columns that were not sampled together."""
    lengths = {name: len(columns[name]) for name in sorted(columns)}
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


def _text_columns(
    path: Path, lines: Iterator[str], export: CaptureHeader | None, wanted: Callable[[str], bool]
) -> Columns:
    """Columns of a text table; one that is not wanted is empty, whatever its cells hold.

    The most frequent character of `,`, `;` and tabulator in the header is the separator.
    """
    if export:
        header, delimiter, above = export.columns, "\t", export.rows
        check_columns(path, header)
    else:
        first, above = next(lines, ""), 1
        delimiter = max(",;\t", key=first.count)
        header = read_header(path, first, delimiter)
    used = [k for k, name in enumerate(header) if wanted(name)]
    samples = read_numbers(path, lines, header, used, delimiter, above)
    columns: Columns = {name: np.zeros(0) for name in header}
    return columns | {header[k]: samples[:, i] for i, k in enumerate(used)}


# --- JSON ------------------------------------------------------------------------------------

_EVERY: Final = "*"
_TOKEN: Final = re.compile(r"([^.\[\]]+)|\[(\d*)\]")
_LONGEST_NAME: Final = 1000
"""Most characters of a path to a single value."""


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


def _json_with_paths(path: Path, mapping: RecordingMap) -> Columns:
    """Columns of a JSON file, with those that the map names by a path."""
    document = _json(path)
    columns = _json_columns(path, document)
    sources = sorted({column.source for column in mapping.columns.values()} - columns.keys())
    nested = [source for source in sources if set(source) & set("./[")]
    return columns | {source: json_values(path, document, source) for source in nested}


def _single_values(node: Any, form: str, prefix: str = "") -> dict[str, Scalar]:
    """Strings and numbers of an object and of all objects in it, by path."""
    result: dict[str, Scalar] = {}
    for name, value in node.items() if isinstance(node, dict) else ():
        own = form.format(prefix, name)
        if len(own) > _LONGEST_NAME:
            continue
        if isinstance(value, str | int | float):
            result[own] = value
        result |= _single_values(value, form, own)
    return result


def json_values(where: Path, document: Any, path: str) -> Sequence[Any]:
    """Values at a path; None for an entry of a list that lacks the last names of the path."""
    found = _follow(where, document, path, _tokens(path), 0)
    if not isinstance(found, list) or any(isinstance(v, dict | list) for v in found):
        raise InputError(
            where, f"{path!r} leads to {_kind(found)}, not to a list of single values",
            "add '[]' where a list has one entry per sample, or the name of a value",
        )  # fmt: skip
    if all(v is None for v in found):
        raise InputError(where, f"{path!r} leads to no value", "correct 'from' in MAP.toml")
    return found


def _tokens(path: str) -> list[str]:
    if path.startswith("/"):
        return [t.replace("~1", "/").replace("~0", "~") for t in path[1:].split("/")]
    return [name or index or _EVERY for name, index in _TOKEN.findall(path)]


def _follow(where: Path, node: Any, path: str, tokens: list[str], depth: int) -> Any:
    """Value below a node, or a list of values if the path passes every entry of a list."""
    if depth == len(tokens):
        return node
    token = tokens[depth]
    if token == _EVERY and isinstance(node, list):
        if _EVERY in tokens[depth + 1 :]:
            raise InputError(
                where, f"{path!r} passes every entry of two lists", "give one of them a number"
            )
        return _of_every_entry(where, node, path, tokens, depth)
    if isinstance(node, dict) and token in node:
        return _follow(where, node[token], path, tokens, depth + 1)
    if isinstance(node, list) and token.isdigit() and int(token) < len(node):
        return _follow(where, node[int(token)], path, tokens, depth + 1)
    raise InputError(where, _dead_end(path, node, tokens, depth), "correct 'from' in MAP.toml")


def _of_every_entry(
    where: Path, entries: list[Any], path: str, tokens: list[str], depth: int
) -> list[Any]:
    """Value of each entry, None if it has none; fails if no entry has one."""
    result: list[Any] = []
    first: InputError | None = None
    for entry in entries:
        try:
            result.append(_follow(where, entry, path, tokens, depth + 1))
        except InputError as error:
            first = first or error
            result.append(None)
    if first is not None and all(v is None for v in result):
        raise first
    return result


def _dead_end(path: str, node: Any, tokens: list[str], depth: int) -> str:
    """Message that says where a path ends."""
    before = ".".join(tokens[:depth]).replace(f".{_EVERY}", "[]") or "the file"
    if isinstance(node, dict):
        has = f"it has {', '.join(map(repr, list(node)[:20])) or 'no names'}"
    elif isinstance(node, list):
        has = f"it is a list of {len(node)}: write '[]' for every entry"
    else:
        has = f"it is {_kind(node)}"
    wanted = "list" if tokens[depth] == _EVERY else repr(tokens[depth])
    return f"{path!r}: {before} holds no {wanted}; {has}"


def _kind(node: Any) -> str:
    if isinstance(node, dict):
        return "an object"
    if isinstance(node, list):
        return "a list of lists or objects"
    return "nothing" if node is None else "a single value"


# --- MATLAB up to version 7 ------------------------------------------------------------------

_MATRIX_COLUMNS: Final = 32
"""Most columns of a matrix whose columns count as channels sampled together."""
MOST_UNPACKED_BYTES: Final = 150_000_000
"""Most unpacked bytes of a file's compressed variables: those of `MOST_CELLS` numbers, and as much
again for variables that are not used."""
_COMPRESSED: Final = 15
"""Type of a compressed element (MAT-File Format, R2019b, table 1-1)."""
_HEADER_BYTES: Final = 128
_REMEDY: Final = "save it with -v7"


def matlab_variables(path: Path) -> dict[str, Any]:
    """Read the variables of a MATLAB file, by name."""
    from scipy.io import loadmat

    data = read_bytes(path, "name an existing MATLAB file")
    _check_unpacked(path, data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for example of two variables with one name
            variables = loadmat(io.BytesIO(data))
    except MemoryError:
        raise
    except Exception as error:  # scipy passes on any error of its parser
        what = f"is not a MATLAB file up to version 7 ({type(error).__name__}: {error})"
        raise InputError(path, what, _REMEDY) from None
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


def _check_unpacked(path: Path, data: bytes) -> None:
    """Refuse compressed variables that unpack to too much, before they are unpacked."""
    order = "big" if data[126:128] == b"MI" else "little"
    at, total = _HEADER_BYTES, 0
    while data[124:126] in (b"\x00\x01", b"\x01\x00") and at + 8 <= len(data):
        kind = int.from_bytes(data[at : at + 4], order)  # type: ignore[arg-type]
        size = int.from_bytes(data[at + 4 : at + 8], order)  # type: ignore[arg-type]
        if kind == _COMPRESSED:
            total += _unpacked_bytes(memoryview(data)[at + 8 : at + 8 + size], total)
        if total > MOST_UNPACKED_BYTES:
            what = f"unpacks to more than {DATA_SIZE.number(MOST_UNPACKED_BYTES)} MB"
            raise InputError(path, what, "save only the variables that are needed")
        at += 8 + size


def _unpacked_bytes(packed: memoryview, before: int) -> int:
    """Size of an unpacked element, counted in pieces up to the first damaged byte."""
    unpack, size = zlib.decompressobj(), 0
    try:
        piece = unpack.decompress(packed, 1 << 20)
        while piece:
            size += len(piece)
            if before + size > MOST_UNPACKED_BYTES:
                break
            piece = unpack.decompress(unpack.unconsumed_tail, 1 << 20)
    except zlib.error:
        pass
    return size
