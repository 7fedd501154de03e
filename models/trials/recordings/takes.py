"""Takes that one map imports: their files, conditions (from file name or table) and servo files."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from firmware_py.errors import InputError
from firmware_py.files.input_files import read_text
from models.trials.recordings.mapping import RecordingMap
from models.trials.trial import TrialMeta

_SUFFIXES: Final = {
    "motive": (".csv",), "c3d": (".c3d",), "recording": (".mcap",),
    "table": (".csv", ".tsv", ".json", ".mat"),
}  # fmt: skip
"""Suffixes of the files in a folder that count as takes, by format."""

_KINDS: Final = {
    field.name: field.type
    for field in msgspec.structs.fields(TrialMeta)
    if field.name not in ("conditions", "recording_sha256")
}
_NAME: Final = "{name}"
"""Placeholder in the name of a servo file for the name of the take."""
_OWN: Final = ("file", "servo", "offset_s")
"""Columns of a table of takes that are not conditions."""
_MOST_TABLE_BYTES: Final = 1_000_000
"""Largest size of a table of takes; tables are written by hand [assumed]."""


class Take(NamedTuple):
    """One recording to import."""

    file: Path
    mapping: RecordingMap
    servo: Path | None
    offset_s: float | None = None  # Offset of the servo's clock, where a table gives it


def find_takes(files: Sequence[Path], kind: str, mapping: RecordingMap) -> list[Take]:
    """Takes among files and folders, each with its conditions.

    A folder stands for the recordings of the format in it; a rosbag is itself a folder.
    """
    rules = mapping.takes
    table_path = Path(mapping.path).parent / rules.table
    table = _table(table_path) if rules.table else {}
    takes = []
    for file in _files(files, kind, mapping, table):
        row = table.get(file.name) or table.get(file.stem) or {}
        if rules.table and not row:
            raise InputError(table_path, f"has no row for {file.name}", "add it")
        conditions = _by_name(file, mapping) if rules.pattern else {}
        conditions |= {k: _value(mapping, k, v) for k, v in row.items() if k not in _OWN and v}
        own = msgspec.structs.replace(mapping, trial=mapping.trial | conditions)
        servo = row.get("servo") or rules.servo.replace(_NAME, file.stem)
        offset_s = _offset_s(table_path, row["offset_s"]) if row.get("offset_s") else None
        takes.append(Take(file, own, file.parent / servo if servo else None, offset_s))
    _refuse_one_name([take.file for take in takes])
    return takes


def _refuse_one_name(files: Sequence[Path]) -> None:
    """Refuse two files of one name, whatever the case: their trials would overwrite each other."""
    known: dict[str, Path] = {}
    for file in files:
        other = known.setdefault(file.stem.casefold(), file)
        if other is file:
            continue
        if other.resolve() == file.resolve():
            raise InputError(file, "is given twice", "name each recording once")
        what = f"would become a trial of the same name as {other}"
        raise InputError(file, what, "rename one of them, or import it alone with --name")


def _files(
    files: Sequence[Path], kind: str, mapping: RecordingMap, table: dict[str, Any]
) -> list[Path]:
    found: list[Path] = []
    for path in files:
        if not path.is_dir() or kind == "rosbag":
            found.append(path)
            continue
        try:
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in _SUFFIXES[kind])
        except OSError as error:
            raise InputError(path, f"cannot be read ({error.strerror})", "name the files") from None
        if table:
            inside = [p for p in inside if p.name in table or p.stem in table]
        servo = {mapping.takes.servo.replace(_NAME, p.stem) for p in inside}
        inside = [p for p in inside if p.name not in servo and p.name != mapping.takes.table]
        if not inside:
            raise InputError(path, f"holds no take of the format {kind}", "name the files")
        found += inside
    return found


def _by_name(file: Path, mapping: RecordingMap) -> dict[str, Any]:
    """Conditions in the name of a file, by the map's pattern.

    Each condition takes the shortest part of the name that fits, at least one character. The first
    match of the text after a condition is correct whenever a match exists, so there is no
    backtracking.
    """
    pattern = mapping.takes.pattern
    first, *parts = re.split(r"\{(\w+)\}", pattern)
    names, behind = parts[::2], parts[1::2]
    if len(set(names)) < len(names):
        raise InputError(
            mapping.path, f"[takes]: {pattern!r} names a condition twice", "correct it"
        )
    rest, found = file.stem.removeprefix(first), {}
    fits = file.stem.startswith(first) and (bool(names) or not rest)
    for k, (name, text) in enumerate(zip(names, behind, strict=True), start=1):
        end = rest.find(text, 1) if k < len(names) else len(rest) - len(text)
        fits = fits and end >= 1 and rest.startswith(text, end)
        found[name], rest = rest[:end], rest[end + len(text) :]
    if not fits:
        raise InputError(
            file,
            f"does not fit the pattern {pattern!r} of {mapping.path}",
            "rename it or correct [takes]",
        )
    return {name: _value(mapping, name, text) for name, text in found.items()}


def _value(mapping: RecordingMap, name: str, text: str) -> Any:
    if name not in _KINDS:
        raise InputError(mapping.path, f"[takes]: {name!r} is no condition", "see docs/trials.md")
    kind: Any = _KINDS[name]
    try:
        return kind(text)
    except ValueError:
        raise InputError(
            mapping.path, f"[takes]: {name} is {text!r}, no number", "correct pattern or table"
        ) from None


def _offset_s(path: Path, text: str) -> float:
    try:
        offset_s = float(text)
    except ValueError:
        offset_s = math.nan
    if not math.isfinite(offset_s):
        raise InputError(path, f"offset_s is {text!r}, no number", "correct it")
    return offset_s


def _table(path: Path) -> dict[str, dict[str, str]]:
    """Rows of a table of takes, by file name."""
    remedy = "correct 'table' in the map"
    try:
        header, *rows = csv.reader(read_text(path, remedy, _MOST_TABLE_BYTES).splitlines() or [""])
    except csv.Error as error:
        raise InputError(path, f"cannot be read ({error})", remedy) from None
    if "file" not in header or not any(rows):
        raise InputError(
            path, "has no column 'file' with a row", "name the file of each take in it"
        )
    _check_single(path, "column", header)
    for number, row in enumerate(rows, start=2):
        if row and len(row) != len(header):
            what = f"line {number} has {len(row)} cells, the header {len(header)}"
            raise InputError(path, what, "correct it")
    takes = [dict(zip(header, row, strict=True)) for row in rows if row]
    _check_single(path, "take", [take["file"] for take in takes])
    return {take["file"]: take for take in takes}


def _check_single(path: Path, what: str, names: Sequence[str]) -> None:
    doubled = next((n for n, count in Counter(names).items() if count > 1), None)
    if doubled is not None:
        raise InputError(path, f"the {what} {doubled[:80]!r} stands twice", "remove one of the two")
