"""Takes as a user would record them, written from a trial: a Motive export and a servo log.

The markers, which a trial without noise gives, are brought to the rate of the cameras by a cubic
spline, get noise, are moved to the frame and clock of the capture, and written with y up. The
servo's log is a table in degrees and milliamperes on another clock. Every field that is not its
default changes the take in one way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import ezc3d
import msgspec
import numpy as np
import tomli_w
from scipy.interpolate import CubicSpline

from firmware_py.config import RobotConfig
from firmware_py.core.signals import PERIOD_S
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.link.marker_layout import square_corners_m
from firmware_py.log.sinks import McapSink, TickEncoder
from models.shared.kinematics import base_corners_m
from models.trials.recordings.mapping import BASE_MARKERS
from models.trials.trial import LINK_CONDITIONS, Array, Trial
from tests.models import made_trials

RATE_HZ: Final = 120.0
NOISE_M: Final = 1.5e-4
"""Noise of the markers, per coordinate and frame: docs/sources.md, "The link"."""
ORIGIN_M: Final = np.array([1.2, -0.7, 0.42])
"""Crossing of the joint axes in the capture's frame, z up."""
RUN_CONDITIONS: Final = ("dof", "payload_kg", "trial", "motion", "period_s", "phase_2_rad")
"""What the map says of the run."""
TO_Y_UP: Final = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def motive_export(
    time_s: Array,
    labels: Sequence[str],
    places: Array,
    *,
    units: str = "Meters",
    version: str = "1.23",
    solved: bool = False,
) -> str:
    """Export of Motive with measured markers; places (n, markers, 3) as they are in the file.

    With `solved`, a rigid body and the places where it expects its markers stand in front. The rows
    of the header depend on the version.
    """
    columns = [("Marker", label, "Position", axis) for label in labels for axis in "XYZ"]
    front = []
    if solved:
        front = [("Rigid Body", "Link", "Rotation", axis) for axis in "XYZW"]
        front += [("Rigid Body", "Link", "Position", axis) for axis in "XYZ"]
        front += [("Rigid Body Marker", n, "Position", axis) for _, n, _, axis in columns]
    kinds, names, measures, axes = map(",".join, zip(*front, *columns, strict=True))
    ids = [f",ID,{names}", f",Parent,{names}"] if version > "1.2" else []
    head = [
        f"Format Version,{version},Take Name,take,Length Units,{units},Coordinate Space,Global",
        "", f",Type,{kinds}", f",Name,{names}", *ids, f",,{measures}",
        f"Frame,Time (Seconds),{axes}",
    ]  # fmt: skip
    rows = [
        f"{k},{t:.6f}," + "9," * len(front) + ",".join("" if v != v else f"{v:.7f}" for v in row)
        for k, (t, row) in enumerate(zip(time_s, places.reshape(len(time_s), -1), strict=True))
    ]
    return "\n".join([*head, *rows]) + "\n"


def write_c3d(
    path: Path,
    markers_m: Array,
    *,
    unit: str = "mm",
    rate_hz: float = 240.0,
    labels: Sequence[str] = (),
    analogs: Mapping[str, tuple[str, Array]] | None = None,
) -> Path:
    """Points (n, 16, 3), and analog channels at twice their rate as (unit, values) by name."""
    file = ezc3d.c3d()
    points = np.ones((4, 16, len(markers_m)))
    points[:3] = {"mm": 1000.0}.get(unit, 1.0) * np.moveaxis(markers_m, -1, 0).transpose(0, 2, 1)
    point, analog = file["parameters"]["POINT"], file["parameters"]["ANALOG"]
    point["UNITS"]["value"], point["RATE"]["value"] = [unit], [rate_hz]
    point["LABELS"]["value"] = list(labels) or [f"m{i:02d}" for i in range(1, 17)]
    file["data"]["points"] = points
    if analogs is not None:
        analog["RATE"]["value"], analog["LABELS"]["value"] = [2 * rate_hz], list(analogs)
        analog["UNITS"]["value"] = [u for u, _ in analogs.values()]
        file["data"]["analogs"] = np.array([[v for _, v in analogs.values()]])
    file.write(str(path))
    return path


ROBOT = {"bundle": "b", "bus": {"port": "p"}, "servos": [{"id": 1, "model": "H54-200-S500-R"}]}


def write_log(path: Path, records: Array, dof: int, **metadata: str) -> Path:
    """Log of `dropstitch run` with ticks as records."""
    config = msgspec.json.encode(msgspec.convert(ROBOT, RobotConfig)).decode()
    facts = {"dof": str(dof), "period_s": repr(PERIOD_S), "config": config} | metadata
    sink, encode = McapSink(str(path), dof, facts), TickEncoder(dof, 10**18)
    for record in records:
        sink.write(*encode(record.tobytes()))
    sink.finish()
    return path


@dataclass
class WrittenTake:
    """How a take is written and mapped."""

    offset_s: float = 0.0  # Servo's clock plus this is the capture's
    epoch_s: float = 0.0  # Added to the servo's clock
    yaw_deg: float = 0.0  # Turn of the capture's frame, which the map knows
    files_up: str = "y"  # {"y", "z"}, Upward axis of the file
    millimetres: bool = False  # Whether the file is in millimetres
    align: str = "none"
    # Marker of the contract to the one whose label it gets in the map
    names: dict[str, str] = field(default_factory=dict)
    absent: tuple[str, ...] = ()  # Markers that the map names and the file lacks
    signs: tuple[float, ...] = (1.0, 1.0)  # Of each servo's angle and goal in the log
    swap_joints: bool = False  # Whether the log's joints are mapped crosswise
    # Keys of `[frame]` that the map gives wrongly
    wrong: dict[str, Any] = field(default_factory=dict)
    first_s: float = 0.0  # Time from which both files are written
    # Start and length of a gap in the servo's log, (0, 0) for none
    gap_s: tuple[float, float] = (0.0, 0.0)
    commas: bool = False  # Whether the log has decimal commas
    lost: float = 0.0  # Fraction of the log's samples that are lost singly
    occluded: float = 0.0  # Fraction of marker cells that are blank
    scale: float = 1.0  # Of the file's positions
    base: str = ""  # {"", "plate", "stand"}, What carries the base's markers; "" for none
    rate_hz: float = RATE_HZ  # Frame rate that the export states, of frames at `RATE_HZ`
    changes: Callable[[dict[str, Any]], None] | None = None  # Of the map, in place
    signals: Callable[[Trial], Trial] | None = None  # Of the trial before its log is written

    def write(self, trial: Trial, directory: Path, seed: int) -> list[str]:
        """Write the files; return the arguments of the import command without --out."""
        rng = np.random.default_rng(seed)
        directory.mkdir(parents=True, exist_ok=True)
        self._write_motive(trial, directory / "take.csv", rng)
        columns = self._write_servo(trial, directory / "servo.csv", rng)
        trial_table = {
            key: value
            for key, value in trial.meta.document().items()
            if key in (*LINK_CONDITIONS, *RUN_CONDITIONS)
        }
        frame: dict[str, Any] = {"align": self.align, "up": self.files_up}
        if self.align == "none":
            frame |= {"origin_m": ORIGIN_M.tolist(), "yaw_deg": self.yaw_deg}
        markers = {name: f"Link:{self.names.get(name, name)}" for name in STUDY_LINK.layout.names}
        if self.base:
            markers |= {name: f"Base:{name}" for name in BASE_MARKERS}
        document = {
            "trial": trial_table, "frame": frame | self.wrong, "markers": markers,
            "servo_columns": columns,
        }  # fmt: skip
        if self.changes is not None:
            self.changes(document)
        (directory / "map.toml").write_text(tomli_w.dumps(document))
        return [
            str(directory / "take.csv"), "--as", "motive", "--servo", str(directory / "servo.csv"),
            "--map", str(directory / "map.toml"),
        ]  # fmt: skip

    def _write_motive(self, trial: Trial, path: Path, rng: np.random.Generator) -> None:
        time_s = trial.time_s
        frames_s = np.arange(max(self.first_s, time_s[0]), time_s[-1], 1 / RATE_HZ)
        markers_m = trial.markers_m
        if self.base:
            meta, angle_rad = trial.meta, trial.angle_rad * float(self.base == "plate")
            corners_m = square_corners_m(meta.link_width_m)
            base_m = base_corners_m(angle_rad, meta.base_offset_m, corners_m)
            markers_m = np.concatenate([markers_m, base_m], axis=1)
        places_m = CubicSpline(time_s, markers_m)(frames_s)
        places_m = places_m + NOISE_M * rng.standard_normal(places_m.shape)
        turn = np.radians(-self.yaw_deg)
        about_z = np.array(
            [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]]
        )
        in_file = places_m @ about_z.T + ORIGIN_M
        in_file = self.scale * (in_file @ TO_Y_UP.T if self.files_up == "y" else in_file)
        if self.millimetres:
            in_file = 1e3 * in_file
        in_file[rng.random(in_file.shape[:2]) < self.occluded] = np.nan
        names = [f"Link:{name}" for name in STUDY_LINK.layout.names]
        names += [f"Base:{name}" for name in BASE_MARKERS] if self.base else []
        present = [k for k, name in enumerate(names) if name.split(":")[1] not in self.absent]
        labels, places = [names[k] for k in present], in_file[:, present]
        times_s = np.arange(len(frames_s)) / self.rate_hz
        units = "Millimeters" if self.millimetres else "Meters"
        path.write_text(motive_export(times_s, labels, places, units=units))

    def _write_servo(
        self, trial: Trial, path: Path, rng: np.random.Generator
    ) -> dict[str, dict[str, Any]]:
        trial = self.signals(trial) if self.signals is not None else trial
        time_s = trial.time_s
        logged = time_s >= self.first_s
        start_s, length_s = self.gap_s
        logged &= (time_s <= start_s) | (time_s >= start_s + length_s)
        logged &= (rng.random(len(time_s)) >= self.lost) | (np.arange(len(time_s)) % 3 > 0)
        stamp_ms = 1e3 * (time_s - self.first_s - self.offset_s + self.epoch_s)
        columns: dict[str, dict[str, Any]] = {"time_s": {"from": "stamp", "unit": "ms"}}
        header, values = ["stamp"], [stamp_ms]
        joints = range(1, trial.meta.dof + 1)
        for j in joints:
            header += [f"goal{j}", f"pos{j}", f"cur{j}"]
            for signal in (trial.goal_rad[:, j - 1], trial.angle_rad[:, j - 1]):
                values.append(np.degrees(signal) * self.signs[j - 1])
            values.append(1e3 * trial.current_a[:, j - 1])
            source = trial.meta.dof + 1 - j if self.swap_joints else j
            columns |= {
                f"goal_{j}_rad": {"from": f"goal{source}", "unit": "deg"},
                f"angle_{j}_rad": {"from": f"pos{source}", "unit": "deg"},
                f"current_{j}_a": {"from": f"cur{j}", "unit": "mA"},
            }
        table: Array = np.column_stack(values)[logged]
        rows = [";".join(f"{v:.4f}" for v in row) for row in table.tolist()]
        text = "\n".join([";".join(header), *rows]) + "\n"
        path.write_text(text.replace(".", ",") if self.commas else text)
        return columns


REST = 60


def rigid_trial(angle_rad: Array) -> Trial:
    """Trial of a link that does not bend."""
    trial = made_trials.rigid_trial(
        angle_rad, name="rigid", motion="test", source="rig", period_s=2.0, rest_samples=REST
    )
    currents_a = {f"current_{j}_a": -2 * angle for j, angle in enumerate(angle_rad.T, start=1)}
    return made_trials.with_columns(trial, **currents_a)
