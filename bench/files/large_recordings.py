"""Large recordings in binary formats: MATLAB, MCAP, C3D, ROS 2 bags."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from bench.files.file_filling import MARKERS, STEP_S, angle_rad, filled, marker_m
from firmware_py.files.input_files import MOST_BYTES


def _matlab(path: Path, rows: int, more: int, *, packed: bool) -> None:
    import numpy as np
    import scipy.io

    time_s = STEP_S * np.arange(rows)
    angle_rad = 0.3 * np.sin(0.6 * np.maximum(time_s - 0.5, 0))
    columns = {"time_s": time_s, "goal_1_rad": angle_rad, "angle_1_rad": angle_rad,
               "current_1_a": 0.1 * np.cos(time_s)}  # fmt: skip
    columns |= {f"more_{k}_rad": np.random.default_rng(k).random(rows) for k in range(more)}
    scipy.io.savemat(path, columns, do_compression=packed, oned_as="column")


def matlab(path: Path) -> None:
    """Uncompressed vectors."""
    _matlab(path, 150_000, 58, packed=False)


def matlab_packed(path: Path) -> None:
    """Compressed vectors."""
    _matlab(path, 150_000, 58, packed=True)


def matlab_head() -> bytes:
    """First 128 bytes of a MAT-file of version 5."""
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


def _matlab_scalar(name: bytes) -> bytes:
    flags = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 1, 1)
    padded = name + bytes(-len(name) % 8)
    content = flags + struct.pack("<II", 1, len(name)) + padded + struct.pack("<IId", 9, 8, 1.0)
    return struct.pack("<II", 14, len(content)) + content


def matlab_many(path: Path) -> None:
    """A million variables of one number."""
    with path.open("wb") as file:
        file.write(matlab_head())
        for k in range(1_100_000):
            file.write(_matlab_scalar(b"v%07d" % k))


def matlab_bomb(path: Path) -> None:
    """Variables that unpack to a thousand times their size."""
    zeros = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 1, 12_500_000)
    zeros += struct.pack("<II", 1, 8) + b"zeros_00" + struct.pack("<II", 9, 100_000_000)
    whole = struct.pack("<II", 14, len(zeros) + 100_000_000) + zeros + bytes(100_000_000)
    packed = zlib.compress(whole)
    filled(path, matlab_head(), struct.pack("<II", 15, len(packed)) + packed)


def log(path: Path) -> None:
    """Log of two joints."""
    import msgspec
    import numpy as np

    from firmware_py.config import RobotConfig
    from firmware_py.log.sinks import McapSink, TickEncoder
    from firmware_py.signals import tick_dtype

    servos = [{"id": k, "model": "XM430-W350"} for k in (1, 2)]
    robot = {"bundle": "b", "bus": {"port": "p"}, "servos": servos}
    config = msgspec.json.encode(msgspec.convert(robot, RobotConfig)).decode()
    metadata = {"dof": "2", "period_s": repr(STEP_S), "config": config, "payload_kg": "0.5"}
    sink, encode = McapSink(str(path), 2, metadata), TickEncoder(2, 10**18)
    record = np.zeros(1, tick_dtype(2))
    noise = np.random.default_rng(1)
    doubles = [name for name in record.dtype.names or () if record.dtype[name].kind == "f"]
    k = 0
    while k % 1000 or path.stat().st_size < MOST_BYTES - 1_500_000:
        for name in doubles:
            record[name] = 0.1 * noise.random()
        record["tick"], record["time_s"] = k, k * STEP_S
        for joint in (1, 2):
            record[f"angle_{joint}_rad"] = record[f"goal_{joint}_rad"] = angle_rad(k)
        sink.write(*encode(record.tobytes()))
        k += 1
    sink.finish()


MCAP: Final = b"\x89MCAP0\r\n"


def _mcap_record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def _mcap_text(text: bytes) -> bytes:
    return struct.pack("<I", len(text)) + text


def log_of_metadata(path: Path) -> None:
    """Metadata of ten million names."""
    head = MCAP + _mcap_record(1, _mcap_text(b"") * 2)
    pairs = b"".join(_mcap_text(b"%07d" % k) + _mcap_text(b"") for k in range(6_600_000))
    content = _mcap_text(b"dropstitch") + struct.pack("<I", len(pairs)) + pairs
    path.write_bytes(head + _mcap_record(12, content))


def log_chunks(path: Path) -> None:
    """Chunks of which each unpacks to 4 MB."""
    import lz4.frame

    packed = lz4.frame.compress(_mcap_record(5, bytes(22) + b" " * 3_999_000))
    chunk = struct.pack("<QQQI", 0, 0, 3_999_031, 0) + _mcap_text(b"lz4")
    chunk += struct.pack("<Q", len(packed)) + packed
    pair = _mcap_text(b"dof") + _mcap_text(b"1")
    facts = _mcap_text(b"dropstitch") + struct.pack("<I", len(pair)) + pair
    head = MCAP + _mcap_record(1, _mcap_text(b"") * 2) + _mcap_record(12, facts)
    filled(path, head, _mcap_record(6, chunk))


def c3d(path: Path) -> None:
    """Sixteen points at 120 Hz; the format holds 65535 frames of them, the rest are analogs."""
    import ezc3d
    import numpy as np

    frames = 65_000
    file = ezc3d.c3d()
    angles = [angle_rad(k // 2) for k in range(frames)]
    points = np.ones((4, 16, frames))
    for m in range(16):
        points[:3, m] = 1000 * np.array([[*marker_m(m, a)] for a in angles]).T
    parameters = file["parameters"]
    for name, value in (("UNITS", ["mm"]), ("RATE", [120.0]), ("LABELS", list(MARKERS))):
        parameters["POINT"][name]["value"] = value
    file["data"]["points"] = points
    channels = 20
    parameters["ANALOG"]["RATE"]["value"] = [1200.0]
    parameters["ANALOG"]["LABELS"]["value"] = [f"a{k}" for k in range(channels)]
    parameters["ANALOG"]["UNITS"]["value"] = ["V"] * channels
    file["data"]["analogs"] = np.ones((1, channels, 10 * frames))
    file.write(str(path))


def c3d_claims(path: Path) -> None:
    """Header that claims 65535 points in 65535 frames, and 100 MB of zeros."""
    import ezc3d
    import numpy as np

    small, file = path.with_name("small.c3d"), ezc3d.c3d()
    for group, labels in (("POINT", ["m01"]), ("ANALOG", [])):
        file["parameters"][group]["RATE"]["value"] = [120.0]
        file["parameters"][group]["LABELS"]["value"] = labels
    file["data"]["points"] = np.ones((4, 1, 3))
    file["data"]["analogs"] = np.zeros((1, 0, 3))
    file.write(str(small))
    data = bytearray(small.read_bytes())
    small.unlink()
    struct.pack_into("<HHHH", data, 2, 65_535, 0, 1, 65_535)
    filled(path, bytes(data), bytes(512))


def _bag(path: Path, messages: Iterator[tuple[int, bytes]], more: str = "") -> None:
    """Bag of joint states and goals in turn, written as a database."""
    path.mkdir()
    with sqlite3.connect(path / "a.db3") as file:
        file.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
            "serialization_format TEXT, offered_qos_profiles TEXT);"
            "INSERT INTO topics VALUES(1, '/joints', 'sensor_msgs/msg/JointState', 'cdr', '');"
            "INSERT INTO topics VALUES(2, '/goals', 'sensor_msgs/msg/JointState', 'cdr', '');"
            + (more or "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
                       "timestamp INTEGER, data BLOB);")
        )  # fmt: skip
        if not more:
            file.executemany(
                "INSERT INTO messages VALUES(NULL, ?1 % 2 + 1, ?2, ?3)",
                ((k, time_ns, data) for k, (time_ns, data) in enumerate(messages)),
            )
        count = 10**6
    (path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 4\n  storage_identifier: sqlite3\n"
        "  relative_file_paths: [a.db3]\n  duration: {nanoseconds: 1}\n"
        "  starting_time: {nanoseconds_since_epoch: 0}\n"
        f"  message_count: {count}\n  compression_format: ''\n  compression_mode: ''\n"
        "  topics_with_message_count:\n"
        + "".join(
            f"    - topic_metadata: {{name: {topic}, type: sensor_msgs/msg/JointState, "
            "serialization_format: cdr, offered_qos_profiles: ''}\n"
            f"      message_count: {count // 2}\n"
            for topic in ("/joints", "/goals")
        ),
        encoding="utf-8",
    )


def _joint_state(k: int, name: bytes = b"base\0") -> bytes:
    time_ns = round(k * STEP_S * 1e9)
    head = struct.pack("<II", time_ns // 10**9, time_ns % 10**9) + struct.pack("<I", 1) + b"\0"
    names = struct.pack("<3xII", 1, len(name)) + name + bytes(-len(name) % 4)
    angle = angle_rad(k)
    pad = -(len(head) + len(names) + 4) % 8
    lists = struct.pack("<I", 1) + bytes(pad) + struct.pack("<d", angle)
    lists += struct.pack("<I", 0) + struct.pack("<I", 1) + struct.pack("<d", 100.0)
    return b"\0\1\0\0" + head + names + lists


def bag(path: Path) -> None:
    """Joint states and goals in 150,000 messages; a long name fills them."""
    name = b"base".ljust(491) + b"\0"
    _bag(path, ((round(k // 2 * STEP_S * 1e9), _joint_state(k // 2, name)) for k in range(150_000)))


def bag_short(path: Path) -> None:
    """A million short joint states."""
    _bag(path, ((round(k // 2 * STEP_S * 1e9), _joint_state(k // 2)) for k in range(900_000)))


def bag_endless(path: Path) -> None:
    """A table of messages that is a query without an end."""
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
    columns = "i AS id, 1 AS topic_id, i AS timestamp, zeroblob(1000000) AS data"
    _bag(path, iter(()), f"CREATE VIEW messages AS {endless} SELECT {columns} FROM n;")
