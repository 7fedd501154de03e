"""Paths into nested JSON: values by a dotted path or a JSON pointer.

`samples[].motor.position` is one value of every entry of a list, `channels.force` a whole list.
`[]` (in a pointer: `*`) stands for every entry of a list, `[2]` for the third one::

    samples[].motor.position      /samples/*/motor/position
    samples[].force[0]            /samples/*/force/0
    rig.load.force                /rig/load/force

A pointer follows RFC 6901 (`~1` is a slash, `~0` a tilde) except for the `*`.

Variables of a MATLAB file up to version 7, bounded before they are read.

Reader of tables (CSV, TSV, JSON, MATLAB) whose columns a map renames to those of a trial.

`read_columns` returns all columns of a file. The map defines their meaning, so the log of another
plant needs another map but no other reader. For JSON a map may also have paths
(`models.trials.recordings.table`).
"""

from __future__ import annotations

import re
import warnings
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.display_units import DATA_SIZE
from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS, read_bytes, read_json
from firmware_py.signals import TIME, unit_of
from models.trials.recordings.mapping import RecordingMap, Scalar
from models.trials.recordings.series import Series, factor_to_si
from models.trials.recordings.text import no_number, read_text_columns, with_capture_columns
from models.trials.trial import Array

EVERY: Final = "*"
_TOKEN: Final = re.compile(r"([^.\[\]]+)|\[(\d*)\]")


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
    return [name or index or EVERY for name, index in _TOKEN.findall(path)]


def _follow(where: Path, node: Any, path: str, tokens: list[str], depth: int) -> Any:
    """Value below a node, or a list of values if the path passes every entry of a list."""
    if depth == len(tokens):
        return node
    token = tokens[depth]
    if token == EVERY and isinstance(node, list):
        if EVERY in tokens[depth + 1 :]:
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
    before = ".".join(tokens[:depth]).replace(f".{EVERY}", "[]") or "the file"
    if isinstance(node, dict):
        has = f"it has {', '.join(map(repr, list(node)[:20])) or 'no names'}"
    elif isinstance(node, list):
        has = f"it is a list of {len(node)}: write '[]' for every entry"
    else:
        has = f"it is {_kind(node)}"
    wanted = "list" if tokens[depth] == EVERY else repr(tokens[depth])
    return f"{path!r}: {before} holds no {wanted}; {has}"


def _kind(node: Any) -> str:
    if isinstance(node, dict):
        return "an object"
    if isinstance(node, list):
        return "a list of lists or objects"
    return "nothing" if node is None else "a single value"


MATRIX_COLUMNS: Final = 32
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
    import io

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


def matlab_scalars(path: Path) -> dict[str, str | int | float]:
    """Single values of a MATLAB file by name."""
    single = {n: np.ravel(v)[0] for n, v in matlab_variables(path).items() if np.size(v) == 1}
    plain = {n: v.item() if isinstance(v, np.generic) else v for n, v in single.items()}
    return {n: v for n, v in plain.items() if isinstance(v, str | int | float)}


def matlab_columns(path: Path) -> dict[str, Any]:
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
        elif value.ndim == 2 and 1 < value.shape[1] <= MATRIX_COLUMNS < len(value):
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
