"""Valid files of every reader, as bytes by name."""

import io
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
import scipy.io
import tomli_w
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from firmware_py.config import RobotConfig
from firmware_py.core.signals import PERIOD_S, tick_dtype
from firmware_py.goals.goal_channel import GoalMessage, encode_goal
from firmware_py.inference.manifest import MANIFEST
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.log.sinks import TickEncoder
from models.commands.new import link_toml
from models.commands.sign import SIGNATURE, sign_bundle
from tests.firmware_py.goals.scripted_program import linear_map
from tests.firmware_py.goals.small_plan import small_plan
from tests.models.trials.recordings.written_takes import (
    ROBOT,
    motive_export,
    write_c3d,
    write_log,
)

ROOT = Path(__file__).resolve().parents[2]
ROWS, REST, STEP_S = 60, 30, 0.017
CONDITIONS = {
    "dof": 1, "payload_kg": 1.0, "pressure_pa": 41300.0, "trial": 1, "motion": "sinusoid",
    "period_s": 4.352, "amplitude_rad": 0.3, "base_offset_m": 0.06, "link_length_m": 0.95,
    "link_width_m": 0.15,
}  # fmt: skip
TIME_S = STEP_S * np.arange(ROWS)
WAVE = 0.3 * np.sin(3 * np.maximum(TIME_S - REST * STEP_S, 0.0))


def _marker_m(number):
    """Marker of the straight link that turns by WAVE about y, shape (ROWS, 3)."""
    row, corner = divmod(number - 1, 4)
    x, y, z = (0.075, -0.075)[corner % 2], (0.075, -0.075)[corner // 2], 0.06 + 0.95 * (row + 1) / 4
    c, s = np.cos(WAVE), np.sin(WAVE)
    return np.column_stack([c * x + s * z, np.full(ROWS, y), c * z - s * x])


MARKERS = {f"m{i:02d}": _marker_m(i) for i in range(1, 17)}


def trial():
    """Trial of the link, one joint, markers partly occluded."""
    columns = {"time_s": TIME_S, "goal_1_rad": WAVE, "angle_1_rad": WAVE, "current_1_a": 3 * WAVE}
    columns |= {f"tip_{axis}_m": WAVE for axis in "xyz"}
    columns |= {f"{m}_{a}_m": p[:, k] for m, p in MARKERS.items() for k, a in enumerate("xyz")}
    lines = [",".join(columns)]
    lines += [",".join(f"{v:.6g}" for v in row) for row in np.column_stack([*columns.values()])]
    lines[4] = lines[4].rsplit(",", 3)[0] + ",,,"
    conditions = {"schema": 1, "source": "measured", "rest_samples": 3, **CONDITIONS}
    return {"run.csv": "\n".join(lines).encode(), "run.toml": tomli_w.dumps(conditions).encode()}


def table():
    """Columns of a servo's log in other units, and the map of them."""
    columns = {"stamp": 1e3 * TIME_S, "pos": np.degrees(WAVE), "cur": 900 * WAVE, "temp": WAVE + 30}
    sources = {
        "time_s": {"from": "stamp", "unit": "ms"}, "goal_1_rad": {"from": "pos", "unit": "deg"},
        "angle_1_rad": {"from": "pos", "unit": "deg"},
        "current_1_a": {"from": "cur", "unit": "mA", "scale": -1.0, "offset": 0.01},
    }  # fmt: skip
    document = {
        "step_s": STEP_S, "trial": CONDITIONS, "columns": sources,
        "frame": {"up": "z", "align": "none", "origin_m": [0.0, 0.0, 0.0], "yaw_deg": 0.0},
        "topics": {"/joints": "joints", "/goals": "goals"}, "joints": ["base"], "effort_unit": "mA",
    }  # fmt: skip
    return columns, tomli_w.dumps(document).encode()


def qtm():
    """Marker export of QTM with the header rows that precede its columns."""
    places_mm = 1e3 * np.column_stack([np.sin(WAVE), 0 * WAVE, np.cos(WAVE)])
    rows = [
        f"{k + 1}\t{t:.5f}\t" + "\t".join(f"{v:.3f}" for v in mm)
        for k, (t, mm) in enumerate(zip(TIME_S, places_mm, strict=True))
    ]
    facts = [f"NO_OF_FRAMES\t{len(rows)}", "FREQUENCY\t100", "MARKER_NAMES\ttip"]
    return "\n".join([*facts, "Frame\tTime\ttip X\ttip Y\ttip Z", *rows]).encode()


def takes():
    """Two takes with their conditions in names and table."""
    map_ = (
        b'[trial]\ndof = 1\n[takes]\npattern = "load{payload_kg}_take{trial}"\n'
        b'table = "takes.csv"\nservo = "{name}_servo.csv"\n'
    )
    table = (
        b"file,pressure_pa,servo,offset_s\nload0.5_take1,41300,,0.1\nload1_take2.csv,41300,a.csv,\n"
    )
    files = {"load0.5_take1.csv": b"", "load1_take2.csv": b"", "load1_take2_servo.csv": b""}
    return files | {"takes.csv": table, "map.toml": map_}


def csv_of(columns):
    rows = np.column_stack([*columns.values()])
    return "\n".join([",".join(columns), *(",".join(map(repr, row.tolist())) for row in rows)])


def json_of(columns):
    rows = [
        dict(zip(columns, map(float, row), strict=True))
        for row in zip(*columns.values(), strict=True)
    ]
    return json.dumps({"name": "log", "mass": 0.5, "entries": rows, "rig": {"kp": 3}}).encode()


def matlab_of(columns, form):
    stream = io.BytesIO()
    more = {"kp": 3.0, "name": "log"} | ({} if form == "4" else {"part": {"a": np.ones((2, 2))}})
    scipy.io.savemat(
        stream, columns | more, format=form[0], do_compression=form == "5c", oned_as="column"
    )
    return stream.getvalue()


def motive():
    """Export of Motive with measured markers."""
    places_m = np.stack([*MARKERS.values()], axis=1)
    return motive_export(TIME_S, list(MARKERS), places_m).encode()


def c3d():
    """Points and one analog channel."""
    places_m = np.stack([*MARKERS.values()], axis=1)
    pos = {"pos": ("deg", np.repeat(np.degrees(WAVE), 2))}
    with TemporaryDirectory() as folder:
        file = Path(folder, "a.c3d")
        return write_c3d(file, places_m, rate_hz=1 / STEP_S, analogs=pos).read_bytes()


def bag():
    """ROS 2 bag with joint states and goals."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    with TemporaryDirectory() as folder:
        with Writer(Path(folder, "bag"), version=9) as file:
            kind = "sensor_msgs/msg/JointState"
            topics = [file.add_connection(t, kind, typestore=store) for t in ("/joints", "/goals")]
            for k, time_s in enumerate(TIME_S):
                at = 1_700_000_000 * 10**9 + round(time_s * 1e9)
                stamp = kinds["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9)
                header = kinds["std_msgs/msg/Header"](stamp, "base")
                value = WAVE[k : k + 1].copy()
                message = kinds[kind](header, ["base"], value, np.zeros(0), 1e3 * value)
                for topic in topics:
                    file.write(topic, at, store.serialize_cdr(message, kind))
        return {f"bag/{p.name}": p.read_bytes() for p in Path(folder, "bag").iterdir()}


def log():
    """Log of `dropstitch run`: bytes, metadata, ticks."""
    records = np.zeros(ROWS, tick_dtype(1))
    records["tick"], records["time_s"] = np.arange(ROWS), PERIOD_S * np.arange(ROWS)
    records["angle_1_rad"] = records["goal_1_rad"] = WAVE
    encode = TickEncoder(1, 10**18)
    config = msgspec.json.encode(msgspec.convert(ROBOT, RobotConfig)).decode()
    metadata = {"dof": "1", "period_s": repr(PERIOD_S), "config": config, "payload_kg": "0.5"}
    with TemporaryDirectory() as folder:
        file = write_log(Path(folder, "a.mcap"), records, 1, payload_kg="0.5")
        return file.read_bytes(), metadata, [encode(r.tobytes())[1] for r in records]


def plan():
    """Plan of the tip for two payloads."""
    with TemporaryDirectory() as folder:
        Path(folder, MANIFEST).write_bytes(b"{}")
        return msgspec.json.encode(small_plan(Path(folder)))


def link():
    """Description of the study's link."""
    return link_toml(STUDY_LINK, 0.4, 0.1).encode()


def goal_map():
    """Map of a rigid link of 1 m, for two payloads, with places out of reach."""
    return msgspec.json.encode(linear_map(gap=True))


def goal_message():
    """Message of a program that sends goals."""
    return encode_goal(GoalMessage(3, (0.1,)))


MOTION = b'schema = 1\nkind = "triangle"\namplitude_rad = 0.2\nperiod_s = 3.0\npayload_kg = 1.0\n'
PATH = b"time_s,x_m,y_m\n0,0,0\n0.5,0.1,0\n1.0,0.1,0.1\n1.5,0,0\n"
CAMPAIGN = b"""kind = "sil"
draws = 3
[fixed]
bundle = "%s"
seconds = 10.0
[grid]
payload_known = [false, true]
seed = {first = 0, count = 2}
[draw]
payload_kg = {uniform = [0.0, 2.0]}
[draw.faults]
lost = {log_uniform = [0.001, 0.05]}
""" % Path(__file__).as_posix().encode()


def key_file():
    """Private key, not encrypted."""
    return Ed25519PrivateKey.from_private_bytes(bytes(32)).private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def plan_run():
    """Plan, and a trial of three runs of it."""
    run = trial()
    goals = json.loads(plan())["payloads"][0]["goals_rad"][0] * 3
    head = run["run.csv"].split(b"\n", 1)[0].decode()
    width = len(head.split(",")) - 3
    rows = [",".join([f"{0.017 * k:.6g}", *[f"{g:.6g}"] * 2, *["0.1"] * width])
            for k, g in enumerate(goals)]  # fmt: skip
    return run | {"plan.json": plan(), "run.csv": "\n".join([head, *rows]).encode()}


def signature():
    """Public key, manifest, and its signature."""
    with TemporaryDirectory() as folder:
        manifest = Path(folder, MANIFEST)
        manifest.write_bytes(b"{}")
        key = sign_bundle(manifest.parent, Ed25519PrivateKey.from_private_bytes(bytes(32)))
        return key, manifest.read_bytes(), Path(folder, SIGNATURE).read_bytes()


def example_of(kind):
    """Smallest document that fits the schema of a struct."""
    schema = msgspec.json.schema(kind)
    tree = _example(schema, schema.get("$defs", {}))
    return json.dumps(tree | ({"schema": kind.VERSION} if "schema" in tree else {})).encode()


def _example(schema, defs):
    if "$ref" in schema:
        return _example(defs[schema["$ref"].rsplit("/", 1)[-1]], defs)
    for key in ("anyOf", "enum"):
        if key in schema:
            first = schema[key][0]
            return first if key == "enum" else _example(first, defs)
    kind = schema.get("type")
    if kind in ("integer", "number") and "minimum" in schema:
        return schema["minimum"]
    if kind == "object":
        known = schema.get("properties", {})
        tree = {name: _example(part, defs) for name, part in known.items()}
        more = schema.get("additionalProperties")
        return tree or ({"a": _example(more, defs)} if isinstance(more, dict) else {})
    if kind == "array":
        items = schema.get("items")
        parts = schema.get("prefixItems") or ([items] if isinstance(items, dict) and items else [])
        return [_example(part, defs) for part in parts]
    return {"integer": 1, "number": 1.0, "boolean": True, "string": "a"}.get(kind)
