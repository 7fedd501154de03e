"""Takes of one map: files, their conditions by file name or table, their servo files."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from firmware_py.errors import InputError
from firmware_py.files.input_files import read_lines
from models.trials.importers.mapping import RecordingMap
from models.trials.trial import TrialMeta

_SUFFIXES: Final = {
    "motive": (".csv",), "c3d": (".c3d",), "recording": (".mcap",),
    "table": (".csv", ".tsv", ".json", ".mat"),
}  # fmt: skip
"""Files of a folder that are takes, by format."""

_KINDS: Final = {
    field.name: field.type
    for field in msgspec.structs.fields(TrialMeta)
    if field.name != "conditions"
}
_OWN: Final = ("file", "servo", "offset_s")
"""Columns of a table of takes that are no conditions."""


class Take(NamedTuple):
    """One recording to import.

    Attributes
    ----------
    file : Path
        The recording.
    mapping : RecordingMap
        With the conditions of this take.
    servo : Path or None
        Its servo file.
    offset_s : float or None
        Offset of the servo's clock, where a table gives it.
    """

    file: Path
    mapping: RecordingMap
    servo: Path | None
    offset_s: float | None = None


def find_takes(files: Sequence[Path], kind: str, mapping: RecordingMap) -> list[Take]:
    """Takes among files and folders, each with its conditions.

    Parameters
    ----------
    files : sequence of Path
        Recordings; a folder stands for those of the format in it (a rosbag is a folder itself).
    kind : str
        Format, as for `--as`.
    mapping : RecordingMap
        With `[takes]`.

    Raises
    ------
    InputError
        If a folder holds no take, a name does not fit the pattern, or the table lacks a take.
    """
    rules = mapping.takes
    table = _table(Path(mapping.path).parent / rules.table) if rules.table else {}
    takes = []
    for file in _files(files, kind, mapping, table):
        row = dict(table.get(file.name) or table.get(file.stem) or {})
        if rules.table and not row:
            raise InputError(
                Path(mapping.path).parent / rules.table, f"has no row for {file.name}", "add it"
            )
        named = _by_name(file, mapping) if rules.pattern else {}
        conditions = named | {
            k: _value(mapping, k, v) for k, v in row.items() if k not in _OWN and v
        }
        own = msgspec.structs.replace(mapping, trial=mapping.trial | conditions)
        servo = row.get("servo") or (rules.servo.format(name=file.stem) if rules.servo else "")
        offset = float(row["offset_s"]) if row.get("offset_s") else None
        takes.append(Take(file, own, file.parent / servo if servo else None, offset))
    return takes


def _files(
    files: Sequence[Path], kind: str, mapping: RecordingMap, table: dict[str, Any]
) -> list[Path]:
    found: list[Path] = []
    for path in files:
        if not path.is_dir() or kind == "rosbag":
            found.append(path)
            continue
        inside = sorted(p for p in path.iterdir() if p.suffix.lower() in _SUFFIXES[kind])
        if table:
            inside = [p for p in inside if p.name in table or p.stem in table]
        servo = (
            {mapping.takes.servo.format(name=p.stem) for p in inside}
            if mapping.takes.servo
            else set()
        )
        inside = [p for p in inside if p.name not in servo and p.name != mapping.takes.table]
        if not inside:
            raise InputError(path, f"holds no take of the format {kind}", "name the files")
        found += inside
    return found


def _by_name(file: Path, mapping: RecordingMap) -> dict[str, Any]:
    """Conditions in the name of a file, by the map's pattern."""
    pattern = mapping.takes.pattern
    parts = re.split(r"\{(\w+)\}", pattern)
    expression = "".join(
        re.escape(part) if k % 2 == 0 else rf"(?P<{part}>.+?)" for k, part in enumerate(parts)
    )
    match = re.fullmatch(expression, file.stem)
    if match is None:
        raise InputError(
            file,
            f"does not fit the pattern {pattern!r} of {mapping.path}",
            "rename it or correct [takes]",
        )
    return {name: _value(mapping, name, text) for name, text in match.groupdict().items()}


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


def _table(path: Path) -> dict[str, dict[str, str]]:
    try:
        rows = list(csv.DictReader(read_lines(path, "correct 'table' in the map")))
    except csv.Error as error:
        raise InputError(path, f"cannot be read ({error})", "correct 'table' in the map") from None
    if not rows or "file" not in rows[0]:
        raise InputError(path, "has no column 'file'", "name the file of each take in it")
    return {row["file"]: row for row in rows}
