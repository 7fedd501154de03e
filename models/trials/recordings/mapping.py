"""Map of a recording (MAP.toml): names, units, frame and conditions that the file lacks.

::

    step_s = 0.017                     # uniform step of the trial
    link = "link.toml"                 # beside the map: size, markers and gravity of your link
    plant = "xl330_pendulum.toml"      # beside the map: [signals] of a plant that is not the link

    [trial]                            # the trial's conditions (docs/trials.md)
    dof = 1                            # schema, source, rest_samples and period_s may be left out
    payload_kg = 1.0
    motion = { from = "trajectory" }   # single value of the file, by its name in it
    …

    [conditions]                       # conditions that the plant declares: a number, or
    duty_gain_1 = { from = "kp", unit = "1", scale = 0.00287736 }   # a single value

    [columns]                          # table, C3D analog: column of the trial = its source
    time_s      = { from = "stamp", unit = "ms" }
    position_1_m = { from = "samples[].motor.position", unit = "mm" }   # path into nested JSON
    angle_1_rad = { from = "Present Position", unit = "deg" }
    current_1_a = { from = "cur", unit = "mA", scale = -1.0, offset = 0.0 }

    [servo_columns]                    # the same for --servo, if it is another table

    [markers]                          # motive, C3D, rosbag: name in the trial = name in the file
    m01 = "Link:Marker 001"
    tip = "EndEffector"

    [topics]                           # rosbag: topic = joints | goals | markers | tip | m01 …
    "/joint_states" = "joints"

    [frame]                            # mocap frame -> world frame
    up = "y"                           # axis of the file along which the link points at zero angle
    mirror = "x"                       # axis of a left-handed file that is reversed
    align = "base"                     # by the base plate's markers b01 … b04, "rest" or "none"
    origin_m = [0.0, 0.0, 0.0]         # crossing of the joint axes, after the turn to z-up
    yaw_deg = 0.0                      # turn about z that takes the file's x to the world's x

    [takes]                            # one map for many files: conditions by file name or table
    pattern = "load{payload_kg}_take{trial}"   # of the file names, without suffix
    table = "takes.csv"                # or a table with a column `file` and one for each condition
    servo = "{name}.mcap"              # servo log of each take, beside it
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import msgspec

from firmware_py.errors import InputError
from firmware_py.files.input_files import convert, read_toml
from firmware_py.link.link_description import STUDY_LINK, LinkDescription, read_link
from firmware_py.link.marker_layout import MarkerLayout
from firmware_py.signals import PERIOD_S
from models.trials.files import check_meta, check_step_range
from models.trials.recordings.series import factor_to_si
from models.trials.trial import SignalRole, TrialMeta
from models.trials.units import check_signal_units

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


class ScalarSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `[trial]` entry whose source is a single value of the file."""

    source: str = msgspec.field(name="from")


class MocapFrame(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Orientation and origin of the motion capture's frame in the world."""

    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    mirror: Literal["x", "y", "z"] | None = None
    align: Literal["rest", "base", "none"] = "none"
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0


class TakeRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[takes]`: conditions and servo logs of many takes; see the module's docstring."""

    pattern: str = ""
    table: str = ""
    servo: str = ""


class RecordingMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Content of MAP.toml; the module's docstring has an example.

    Attributes
    ----------
    trial : dict
        Conditions of the trial, by key of its TOML file.
    conditions : dict
        Conditions that the plant's file declares, by name.
    plant : str
        Plant document beside the map, for a plant that is not the link; empty for the link.
    signals : dict of str to SignalRole
        Signals that the plant document declares.
    link : str
        Description of the link beside the map; empty for the study's.
    described : LinkDescription
        Content of that description; `[trial]` may leave out what it states.
    step_s : float
        Uniform step of the trial in s.
    step_named : bool
        Whether the map states the step, as opposed to the default.
    columns, servo_columns : dict of str to ColumnSource
        Sources of the trial's columns in the file, and in the file of `--servo`.
    markers : dict of str to str
        Name in the file by marker of the trial; empty if the names are the same.
    topics : dict of str to str
        Role by topic of a ROS 2 bag.
    joints : list of str
        Names of joint 1 and joint 2 in a ROS 2 bag; empty for the order of the message.
    effort_unit : str
        Unit of `JointState.effort` in a ROS 2 bag.
    frame : MocapFrame
        Frame of the motion capture.
    takes : TakeRules
        Conditions and servo logs of many takes.
    path : str
        Path of the map, for messages.
    """

    trial: dict[str, Scalar | ScalarSource] = {}
    conditions: dict[str, float | ColumnSource] = {}
    plant: str = ""
    signals: dict[str, SignalRole] = {}
    link: str = ""
    described: LinkDescription = STUDY_LINK
    step_s: float = PERIOD_S
    step_named: bool = False
    columns: dict[str, ColumnSource] = {}
    servo_columns: dict[str, ColumnSource] = {}
    markers: dict[str, str] = {}
    topics: dict[str, str] = {}
    joints: list[str] = []
    effort_unit: str = "A"
    frame: MocapFrame = MocapFrame()
    takes: TakeRules = TakeRules()
    path: str = "--map"

    def meta(self, rest_samples: int, duration_s: float | None = None) -> TrialMeta:
        """Return the conditions of the trial.

        Parameters
        ----------
        rest_samples : int
            Rows at rest, used if the map does not set them.
        duration_s : float, optional
            Period in s for a plant that is not the link, used if the map does not set it.

        Raises
        ------
        InputError
            If a condition is missing or out of range.
        """
        document: dict[str, object] = {
            "source": "measured",
            "rest_samples": rest_samples,
            **({"dof": self.described.joints, **self.described.conditions()} if self.link else {}),
            **self.trial,
        }
        if self.signals and duration_s is not None:
            document = {"period_s": duration_s} | document
        if self.conditions:
            document["conditions"] = self.conditions
        return check_meta(document, Path(self.path), self.signals)

    def with_scalars(self, scalars: Mapping[str, Scalar], where: Path) -> RecordingMap:
        """Return the map with every `{ from = … }` of a single value replaced by that value.

        Parameters
        ----------
        scalars : mapping of str to str, int or float
            Single values of the file, by name.
        where : Path
            File with the values, for messages.

        Raises
        ------
        InputError
            If the file lacks a value, or a condition is not a number.
        """
        trial: dict[str, Scalar | ScalarSource] = {
            key: self._condition(scalars, where, key, entry.source)
            if isinstance(entry, ScalarSource)
            else entry
            for key, entry in self.trial.items()
        }
        conditions: dict[str, float | ColumnSource] = {}
        for key, entry in self.conditions.items():
            if isinstance(entry, ColumnSource):
                raw = self._scalar(scalars, where, key, entry.source)
                declared = self.signals[key].unit if key in self.signals else None
                if not isinstance(raw, int | float):
                    raise InputError(where, f"{entry.source} is {raw!r}, no number", "correct it")
                factor = entry.scale * factor_to_si(
                    Path(self.path), key, entry.unit or declared or "1", declared
                )
                conditions[key] = float(raw) * factor + entry.offset
            else:
                conditions[key] = entry
        return msgspec.structs.replace(self, trial=trial, conditions=conditions)

    def _condition(self, scalars: Mapping[str, Scalar], where: Path, key: str, name: str) -> Scalar:
        """Single value as a condition of the trial; a motion's name is text, even a number."""
        value = self._scalar(scalars, where, key, name)
        return f"{value:g}" if key == "motion" and isinstance(value, int | float) else value

    def _scalar(self, scalars: Mapping[str, Scalar], where: Path, key: str, name: str) -> Scalar:
        if name not in scalars:
            raise InputError(
                where, f"lacks {name!r}, from which {self.path} takes {key}",
                "write the value itself into the map",
            )  # fmt: skip
        return scalars[name]

    def for_servo(self) -> RecordingMap:
        """Return the map for reading the file of `--servo`."""
        return msgspec.structs.replace(self, columns=self.servo_columns or self.columns)

    @property
    def dof(self) -> int:
        """Number of joints of the trial, 1 or 2.

        Raises
        ------
        InputError
            If the map does not state it.
        """
        dof = self.trial.get("dof", self.described.joints if self.link else None)
        if dof not in (1, 2):
            raise InputError(self.path, f"[trial] dof is {dof!r}", "set dof = 1 or dof = 2")
        return 1 if dof == 1 else 2

    def is_goal(self, column: str) -> bool:
        """Whether a column is held from one sample to the next."""
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


def read_mapping(path: Path | None) -> RecordingMap:
    """Read MAP.toml; without a map, the file must have the names and units of a trial."""
    if path is None:
        return RecordingMap()
    document = read_toml(path, "name an existing MAP.toml")
    mapping = convert(document, RecordingMap, path, "", "see docs/trials.md for its form")
    if mapping.link:
        mapping = msgspec.structs.replace(mapping, described=read_link(path.parent / mapping.link))
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
    mapping = msgspec.structs.replace(mapping, path=str(path), step_named="step_s" in document)
    if mapping.plant:
        mapping = msgspec.structs.replace(mapping, signals=_signals(path.parent / mapping.plant))
    return mapping


def _refuse_doubled(mapping: RecordingMap, path: Path) -> None:
    """Refuse two names for one source; only a goal may share the column of another signal."""
    joints = {f"joint {j}": name for j, name in enumerate(mapping.joints, start=1)}
    tables = [("[markers]", mapping.markers), ("'joints'", joints)]
    both = {"[columns]": mapping.columns, "[servo_columns]": mapping.servo_columns}
    for key, columns in ({} if mapping.plant else both).items():
        signals = {name: column.source for name, column in columns.items() if name != "time_s"}
        tables.append((key, signals))
    for key, table in tables:
        first: dict[str, str] = {}
        for name, source in table.items():
            pair = {name.partition("_")[0], first.get(source, name).partition("_")[0]}
            if source in first and pair not in ({"goal"}, {"goal", "angle"}):
                raise InputError(
                    path, f"{key} takes {first[source]} and {name} both from {source!r}",
                    "name the source of each",
                )  # fmt: skip
            first.setdefault(source, name)


def _signals(path: Path) -> dict[str, SignalRole]:
    """Signals that a plant document declares; nothing else of it is read."""
    entries = read_toml(path, "correct 'plant' in the map").get("signals", {})
    signals = convert(entries, dict[str, SignalRole], path, "is no plant document", "correct it")
    check_signal_units(path, signals)
    return signals
