"""Map of recordings (MAP.toml): names, units, frame and conditions that the files lack.

docs/trials.md, "Importing recordings", has a map for each format. One map may import many takes,
whose conditions come from the names of their files or from a table.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_text, read_toml, resolved
from firmware_py.core.signals import PERIOD_S
from firmware_py.link.link_description import STUDY_LINK, LinkDescription, read_link
from firmware_py.link.marker_layout import MarkerLayout
from models.shared.numeric_text import read_header, read_rows
from models.trials.files import check_meta, check_step_range
from models.trials.trial import SignalRole, TrialMeta
from models.trials.units import check_signal_units, factor_to_si

Scalar = str | int | float
"""Single value of a file or of a condition."""

BASE_MARKERS = ("b01", "b02", "b03", "b04")
"""Corners of the base plate, in the order of a row; they align the frame and the clock."""


class ColumnSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One `[columns]` entry: SI value = raw value x scale x (unit to SI) + offset."""

    source: str = msgspec.field(name="from")
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0

    def to_si(
        self, where: Path | str, name: str, raw: Any, declared: str | None, unit: str | None = None
    ) -> Any:
        """Value or values of `name` in SI units; `unit` is that of the source, if it states one.

        `declared` is the SI unit of a name without a suffix.
        """
        factor = factor_to_si(Path(where), name, self.unit or unit or declared or "1", declared)
        return raw * (self.scale * factor) + self.offset


class ScalarSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `[trial]` entry whose source is a single value of the file."""

    source: str = msgspec.field(name="from")


class MocapFrame(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Orientation and origin of the motion capture's frame in the world."""

    # Axis of the file along which the link points at zero angle; None for that of the format
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    # Axis of a left-handed file that is reversed
    mirror: Literal["x", "y", "z"] | None = None
    # What lays the markers on the nominal robot: the link's rest pose, the base plate's markers
    align: Literal["rest", "base", "none"] = "none"
    # Crossing of the joint axes, after the turn to z-up
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # Turn about z that takes the file's x to the world's x
    yaw_deg: float = 0.0


class TakeRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[takes]`: conditions and servo logs of many takes."""

    # Of the files' names without suffix, like "load{payload_kg}_take{trial}"
    pattern: str = ""
    # Or a table with a column `file` and one for each condition, beside the map
    table: str = ""
    # Servo log of each take, beside it, like "{name}.mcap"
    servo: str = ""


class MapFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Content of MAP.toml."""

    # Conditions of the trial, by key of its TOML file
    trial: dict[str, Scalar | ScalarSource] = {}
    # Conditions that the plant's file declares, by name
    conditions: dict[str, float | ColumnSource] = {}
    # Plant document beside the map, for a plant that is not the link
    plant: str = ""
    # Description of the link beside the map; empty for the study's link
    link: str = ""
    # Uniform step of the trial in s
    step_s: float = PERIOD_S
    # Sources of the trial's columns in the recording, and in the file of `--servo`
    columns: dict[str, ColumnSource] = {}
    servo_columns: dict[str, ColumnSource] = {}
    # Name in the file by marker of the trial; empty if the names are the same
    markers: dict[str, str] = {}
    # Role by topic of a ROS 2 bag; its names of joint 1 and joint 2, empty for the message's order
    topics: dict[str, str] = {}
    joints: list[str] = []
    # Unit of `JointState.effort`
    effort_unit: str = "A"
    frame: MocapFrame = MocapFrame()
    takes: TakeRules = TakeRules()


class RecordingMap(MapFile, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Map with the content of the files that it names."""

    # Signals of the plant; none for the link
    signals: dict[str, SignalRole] = {}
    described: LinkDescription = STUDY_LINK
    # Whether the map states `step_s`
    step_named: bool = False
    # Table that names the columns of the file being read
    table: Literal["[columns]", "[servo_columns]"] = "[columns]"
    # Path of the map, for messages
    path: str = "--map"

    def meta(self, rest_samples: int, duration_s: float | None = None) -> TrialMeta:
        """Conditions of the trial.

        `rest_samples` counts where the map sets none, and `duration_s` as the period of a plant
        that is not the link.
        """
        document: dict[str, object] = {"source": "measured", "rest_samples": rest_samples}
        if self.link:
            document |= {"dof": self.described.joints, **self.described.conditions()}
        if self.signals and duration_s is not None:
            document["period_s"] = duration_s
        document |= self.trial
        if self.conditions:
            document["conditions"] = self.conditions
        return check_meta(document, Path(self.path), self.signals)

    def with_scalars(self, scalars: Mapping[str, Scalar], where: Path) -> RecordingMap:
        """Map with every `{ from = … }` of a single value replaced by that value of a file."""
        trial, conditions = dict(self.trial), dict(self.conditions)
        for key, entry in (*self.trial.items(), *self.conditions.items()):
            if not isinstance(entry, ScalarSource | ColumnSource):
                continue
            if entry.source not in scalars:
                raise InputError(
                    where, f"lacks {entry.source!r}, from which {self.path} takes {key}",
                    "write the value itself into the map",
                )  # fmt: skip
            raw = scalars[entry.source]
            if isinstance(entry, ScalarSource):
                trial[key] = f"{raw:g}" if key == "motion" and not isinstance(raw, str) else raw
            elif isinstance(raw, str):
                raise InputError(where, f"{entry.source} is {raw!r}, no number", "correct it")
            else:
                declared = self.signals[key].unit if key in self.signals else None
                conditions[key] = entry.to_si(self.path, key, float(raw), declared)
        return msgspec.structs.replace(self, trial=trial, conditions=conditions)

    def for_servo(self) -> RecordingMap:
        """Map for reading the file of `--servo`; one that has no `[servo_columns]` is the same."""
        if not self.servo_columns:
            return self
        return msgspec.structs.replace(self, columns=self.servo_columns, table="[servo_columns]")

    @property
    def dof(self) -> int:
        """Number of joints of the trial, 1 or 2."""
        dof = self.trial.get("dof", self.described.joints if self.link else None)
        if dof not in (1, 2):
            raise InputError(self.path, f"[trial] dof is {dof!r}", "set dof = 1 or dof = 2")
        return 1 if dof == 1 else 2

    def is_goal(self, column: str) -> bool:
        """Whether a column is constant from one sample to the next."""
        if column in self.signals:
            return self.signals[column].role == "goal"
        return column.startswith("goal")

    @property
    def layout(self) -> MarkerLayout:
        """Layout of the markers on the link."""
        return self.described.layout

    @property
    def known_markers(self) -> tuple[str, ...]:
        """Names that a marker of the trial can have."""
        return (*self.layout.names, *BASE_MARKERS, "tip")

    def marker_of(self, name: str) -> str | None:
        """Return the trial's name (`m01` …, `tip`) of the file's marker `name`, or None."""
        for marker, source in self.markers.items():
            if name == source:
                return marker
        bare = name.rsplit(":", 1)[-1].strip().lower()
        return bare if not self.markers and bare in self.known_markers else None


def no_markers(path: Path, names: Iterable[str]) -> InputError:
    """Error of a file of which the map names no marker."""
    listed = ", ".join(list(dict.fromkeys(filter(None, names)))[:20]) or "no names"
    what = f"holds none of the mapped markers; it has {listed}"
    return InputError(path, what, 'map them under [markers] in MAP.toml, like m01 = "Link:Marker1"')


def read_mapping(path: Path | None) -> RecordingMap:
    """Read MAP.toml; without a map, the file must have the names and units of a trial."""
    if path is None:
        return RecordingMap()
    document = read_toml(path, "name an existing MAP.toml")
    file = convert(document, MapFile, path, "", "see docs/trials.md for its form")
    mapping = RecordingMap(
        **msgspec.structs.asdict(file), path=str(path), step_named="step_s" in document,
        described=read_link(path.parent / file.link) if file.link else STUDY_LINK,
        signals=_signals(path.parent / file.plant) if file.plant else {},
    )  # fmt: skip
    for name in mapping.markers:
        if name not in mapping.known_markers:
            last = mapping.layout.names[-1]
            raise InputError(
                path, f"[markers] {name!r} is no marker", f"use m01 … {last}, tip or b01 … b04"
            )
    _refuse_doubled(mapping, path)
    if not mapping.step_s > 0:
        raise InputError(path, f"step_s is {mapping.step_s}", f"give one above 0, like {PERIOD_S}")
    if not mapping.plant:
        check_step_range(path, "step_s", mapping.step_s)
    return mapping


def _refuse_doubled(mapping: RecordingMap, path: Path) -> None:
    """Refuse two names for one source; only a goal may share the column of another signal."""
    joints = {f"joint {j}": name for j, name in enumerate(mapping.joints, start=1)}
    tables = {"[markers]": mapping.markers, "'joints'": joints}
    both = {"[columns]": mapping.columns, "[servo_columns]": mapping.servo_columns}
    for key, columns in ({} if mapping.plant else both).items():
        tables[key] = {n: column.source for n, column in columns.items() if n != "time_s"}
    for key, table in tables.items():
        first: dict[str, str] = {}
        for name, source in table.items():
            other = first.setdefault(source, name)
            pair = {name.partition("_")[0], other.partition("_")[0]}
            if other != name and pair not in ({"goal"}, {"goal", "angle"}):
                raise InputError(
                    path, f"{key} takes {other} and {name} both from {source!r}",
                    "name the source of each",
                )  # fmt: skip


def _signals(path: Path) -> dict[str, SignalRole]:
    """Signals that a plant document declares; nothing else of it is read."""
    entries = read_toml(path, "correct 'plant' in the map").get("signals", {})
    signals = convert(entries, dict[str, SignalRole], path, "is no plant document", "correct it")
    check_signal_units(path, signals)
    return signals


# --- takes: files that one map imports, with their conditions and servo logs ----------------------

_SUFFIXES: Final = {
    "motive": (".csv",), "c3d": (".c3d",), "recording": (".mcap",),
    "table": (".csv", ".tsv", ".trc", ".json", ".mat"),
}  # fmt: skip
"""Suffixes of the files in a folder that count as takes, by format."""

_KINDS: Final[dict[str, Any]] = {
    field.name: field.type
    for field in msgspec.structs.fields(TrialMeta)
    if field.type in (int, float, str) and field.name != "recording_sha256"
} | {"offset_s": float}
"""Types of the conditions in a file's name or a table, and of the offset of the servo's clock."""
_MOST_TABLE_BYTES: Final = 1_000_000
"""Largest size of a table of takes; tables are written by hand [assumed]."""


class Take(NamedTuple):
    """One recording to import."""

    file: Path
    mapping: RecordingMap
    servo: Path | None = None  # Second file with the servo's signals
    offset_s: float | None = None  # Offset of the servo's clock; None to estimate it


def find_takes(files: Sequence[Path], kind: str, mapping: RecordingMap) -> list[Take]:
    """Takes among files and folders, each with its conditions.

    A folder stands for the recordings of the format in it; a rosbag is itself a folder.
    """
    rules = mapping.takes
    table_path = Path(mapping.path).parent / rules.table
    table = _table(table_path) if rules.table else {}
    takes = []
    for file in _files(files, kind, rules, table):
        row = table.get(file.name) or table.get(file.stem) or {}
        if rules.table and not row:
            raise InputError(table_path, f"has no row for {file.name}", "add it")
        conditions = _by_name(file, mapping) if rules.pattern else {}
        texts = {k: v for k, v in row.items() if k not in ("file", "servo") and v}
        conditions |= {name: _value(table_path, name, text) for name, text in texts.items()}
        offset_s = conditions.pop("offset_s", None)
        servo = row.get("servo") or _servo_of(file, rules)
        take_map = msgspec.structs.replace(mapping, trial=mapping.trial | conditions)
        takes.append(Take(file, take_map, file.parent / servo if servo else None, offset_s))
    _refuse_one_name([take.file for take in takes])
    return takes


def _servo_of(file: Path, rules: TakeRules) -> str:
    return rules.servo.replace("{name}", file.stem)


def _refuse_one_name(files: Sequence[Path]) -> None:
    """Refuse two files of one name, whatever the case: their trials would overwrite each other."""
    known: dict[str, Path] = {}
    for file in files:
        other = known.setdefault(file.stem.casefold(), file)
        if other is not file and resolved(other) == resolved(file):
            raise InputError(file, "is named twice", "name each recording once")
        if other is not file:
            what = f"would become a trial of the same name as {other}"
            raise InputError(file, what, "rename one of them, or import it alone with --name")


def _files(files: Sequence[Path], kind: str, rules: TakeRules, table: dict[str, Any]) -> list[Path]:
    """Recordings among files and folders, without servo logs and the table of takes."""
    recordings: list[Path] = []
    for path in files:
        if not path.is_dir() or kind == "rosbag":
            recordings.append(path)
            continue
        try:
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in _SUFFIXES[kind])
        except OSError as error:
            raise InputError(path, f"cannot be read ({error.strerror})", "name the files") from None
        if table:
            inside = [p for p in inside if p.name in table or p.stem in table]
        others = {rules.table, *(_servo_of(p, rules) for p in inside)}
        inside = [p for p in inside if p.name not in others]
        if not inside:
            raise InputError(path, f"holds no take of the format {kind}", "name the files")
        recordings += inside
    return recordings


def _by_name(file: Path, mapping: RecordingMap) -> dict[str, Any]:
    """Conditions in the name of a file, by the map's pattern.

    Each condition takes the shortest part of the name that fits, at least one character. The groups
    are atomic: the first match of the text after a condition is correct whenever one exists.
    """
    pattern = mapping.takes.pattern
    first, *parts = re.split(r"\{(\w+)\}", pattern)
    names, texts = parts[::2], [re.escape(text) for text in parts[1::2]]
    if len(set(names)) < len(names):
        what = f"[takes]: {pattern!r} names a condition twice"
        raise InputError(mapping.path, what, "correct it")
    groups = [f"(?>(.+?){text})" for text in texts[:-1]] + [f"(.+){text}" for text in texts[-1:]]
    fit = re.fullmatch(re.escape(first) + "".join(groups), file.stem, re.DOTALL)
    if fit is None:
        what = f"does not fit the pattern {pattern!r} of {mapping.path}"
        raise InputError(file, what, "rename it or correct [takes]")
    values = zip(names, fit.groups(), strict=True)
    return {name: _value(mapping.path, name, text) for name, text in values}


def _value(where: Path | str, name: str, text: str) -> Any:
    if name not in _KINDS:
        raise InputError(where, f"[takes]: {name!r} is no condition", "see docs/trials.md")
    try:
        value = _KINDS[name](text)
    except ValueError:
        value = math.nan
    if isinstance(value, float) and not math.isfinite(value):
        what = f"[takes]: {name} is {text!r}, no number"
        raise InputError(where, what, "correct pattern or table")
    return value


def _table(path: Path) -> dict[str, dict[str, str]]:
    """Rows of a table of takes, by file name."""
    lines = iter(read_text(path, "correct 'table' in the map", _MOST_TABLE_BYTES).splitlines())
    header = read_header(path, next(lines, ""))
    rows = [dict(zip(header, row, strict=True)) for _, row in read_rows(path, lines, header)]
    if "file" not in header or not rows:
        remedy = "name the file of each take in it"
        raise InputError(path, "has no column 'file' with a row", remedy)
    takes: dict[str, dict[str, str]] = {}
    for row in rows:
        if takes.setdefault(row["file"], row) is not row:
            what = f"the take {row['file'][:80]!r} stands twice"
            raise InputError(path, what, "remove one of the two")
    return takes
