"""Reader of ROS 2 bags (through rosbags, without ROS).

The map's `[topics]` states the role of each topic: `joints` (sensor_msgs/JointState: position and
effort become angle and current), `goals` (JointState), `markers` (MarkerArray or PoseArray), or the
name of one marker (`tip`, `m01` …; PointStamped, PoseStamped or TransformStamped). Joints keep the
order of the message unless the map lists their names under `joints`. The time of a message is the
stamp of its header, or the time of recording without one.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import MOST_BYTES, open_bounded
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series, marker_columns
from models.trials.units import factor_to_si

MOST_FILES: Final = 100
"""Most files of a bag."""
MOST_METADATA_BYTES: Final = 100_000
"""Largest size of metadata.yaml: 200 topics, for which its parser needs a second."""
Samples = list[tuple[float, dict[str, Any]]]


def read_ros2_bag(path: Path, mapping: RecordingMap) -> list[Series]:
    """Read joint states, goals and markers of a bag, one series per topic."""
    if not mapping.topics:
        raise InputError(
            mapping.path, "names no topics", 'add [topics] like "/joint_states" = "joints"'
        )
    samples: dict[str, Samples] = {}
    _check_files(path)
    for topic, recorded_ns, message in _messages(path, list(mapping.topics)):
        try:
            values = _values(path, message, topic, mapping)
            samples.setdefault(topic, []).append((_stamp_s(message, recorded_ns), values))
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            what = f"a message of {topic} has another form ({error})"
            raise InputError(path, what, "correct [topics] in MAP.toml") from None
    if not samples:
        raise InputError(path, "holds no message of [topics]", "correct [topics] in MAP.toml")
    return [_series(path, topic, rows, mapping) for topic, rows in samples.items()]


def _check_files(path: Path) -> None:
    """Refuse a bag whose files are not regular, too large or too many."""
    if not path.is_dir():
        open_bounded(path, "name the directory of the bag").close()
        return
    files = list(itertools.islice(path.iterdir(), MOST_FILES + 1))
    if len(files) > MOST_FILES:
        raise InputError(path, f"holds more than {MOST_FILES} files", "name one bag")
    remaining, remedy = MOST_BYTES, "name the directory of a bag"
    for file in files:
        most = MOST_METADATA_BYTES if file.suffix == ".yaml" else MOST_BYTES
        with open_bounded(file, remedy, min(max(remaining, 0), most)) as stream:
            remaining -= stream.seek(0, io.SEEK_END)


def _messages(path: Path, topics: list[str]) -> Iterator[tuple[str, int, Any]]:
    """Topic, time of recording in ns and content of every message on these topics."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            known = {c.topic for c in bag.connections}
            for topic in topics:
                if topic not in known:
                    raise InputError(
                        path,
                        f"topic {topic} is missing; it has " + ", ".join(sorted(known)),
                        "correct [topics] in MAP.toml",
                    )
            chosen = [c for c in bag.connections if c.topic in topics]
            for connection, recorded_ns, raw in bag.messages(connections=chosen):
                yield connection.topic, recorded_ns, bag.deserialize(raw, connection.msgtype)
    except (InputError, MemoryError, GeneratorExit):
        raise
    except Exception as error:  # parsers of SQLite, YAML, MCAP and CDR raise many types
        what = f"is no readable ROS 2 bag ({type(error).__name__}: {error})"
        raise InputError(path, what, "name its directory, or record it again") from None


def _stamp_s(message: Any, recorded_ns: int) -> float:
    header = getattr(message, "header", None)
    if header is None and getattr(message, "markers", None) is not None and len(message.markers):
        header = message.markers[0].header
    stamp_ns = header.stamp.sec * 10**9 + header.stamp.nanosec if header is not None else 0
    return (stamp_ns or recorded_ns) * 1e-9


def _values(path: Path, message: Any, topic: str, mapping: RecordingMap) -> dict[str, Any]:
    """Scalars (joints) or positions (markers) of one message, by column name."""
    role = mapping.topics[topic]
    if role in ("joints", "goals"):
        return _joints(path, message, role, topic, mapping)
    if role == "markers":
        if hasattr(message, "markers"):
            named = [(f"{m.ns}{m.id}", m.pose.position) for m in message.markers]
            return {o: _xyz(p) for name, p in named if (o := mapping.marker_of(name))}
        return {
            name: _xyz(p.position)
            for name, p in zip(mapping.layout.names, message.poses, strict=False)
        }
    for part in ("point", "pose", "transform"):
        if hasattr(message, part) and role in mapping.known_markers:
            inner = getattr(message, part)
            return {role: _xyz(getattr(inner, "position", getattr(inner, "translation", inner)))}
    raise InputError(
        path,
        f"topic {topic} ({type(message).__name__}) cannot be read as {role!r}",
        "map it as joints, goals, markers, tip or m01 … m16",
    )


def _joints(
    path: Path, message: Any, role: str, topic: str, mapping: RecordingMap
) -> dict[str, Any]:
    order = list(mapping.joints) or list(message.name)
    values: dict[str, Any] = {}
    for j, name in enumerate(order[: mapping.dof], start=1):
        if name not in message.name:
            what = f"topic {topic} has no joint {name!r}, only " + ", ".join(message.name)
            raise InputError(path, what, "correct 'joints' in MAP.toml")
        k = list(message.name).index(name)
        if role == "goals":
            values[f"goal_{j}_rad"] = message.position[k]
            continue
        factor = factor_to_si(Path(mapping.path), f"current_{j}_a", mapping.effort_unit)
        values[f"angle_{j}_rad"] = message.position[k]
        effort = message.effort[k] if k < len(message.effort) else np.nan
        values[f"current_{j}_a"] = factor * effort
    return values


def _xyz(position: Any) -> tuple[float, float, float]:
    return (position.x, position.y, position.z)


def _series(path: Path, topic: str, rows: Samples, mapping: RecordingMap) -> Series:
    rows.sort(key=lambda row: row[0])
    time_s = np.array([time for time, _ in rows])
    names = sorted({name for _, values in rows for name in values})
    is_joints = mapping.topics[topic] in ("joints", "goals")
    empty = np.nan if is_joints else (np.nan,) * 3
    columns = {n: np.array([v.get(n, empty) for _, v in rows], float) for n in names}
    return Series(time_s, columns if is_joints else marker_columns(columns), path)
