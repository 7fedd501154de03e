"""Readers that the fuzzer feeds: valid files, their mutation, and the call that reads them."""

import io
import json
import random
import sqlite3
import tomllib
import zipfile
import zlib
from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from firmware_py.core.errors import InputError
from firmware_py.inference.manifest import content_sha256
from tests.fuzz import command_readers, valid_files
from tests.fuzz.mutations_of_files import LONGEST, of_bytes, of_json, of_text, of_toml

Files = dict[str, bytes]


class FuzzReader(NamedTuple):
    """Reader by name: its valid files, what changes one or more of them, and what reads them."""

    name: str
    files: Files
    mutate: Callable[[random.Random, Files], Files]
    read: Callable[[Path], object]

    @property
    def fed(self):
        """Whether there are valid files to mutate."""
        return any(self.files.values())


def toml_file(rng, data):
    return of_toml(rng, data, tomllib.loads)


def one(name, mutation):
    """Mutation of one file."""
    return lambda rng, files: {name: mutation(rng, files[name])}


def one_of(*mutations):
    return lambda rng, data: rng.choice(mutations)(rng, data)


def importing(kind, name, servo=None):
    """Import of a file by the command, without its console."""

    def read(folder):
        from models.commands import import_

        parser = ArgumentParser()
        import_.configure(parser)
        parser.add_argument("--json", action="store_true")
        more = ["--servo", str(folder / servo), "--offset", "0"] if servo else []
        argv = [str(folder / name), "--as", kind, "--map", str(folder / "map.toml"), *more]
        import_.run(parser.parse_args([*argv, "--name", "trial", "--out", str(folder / "out")]))

    return read


def of_zip(rng, data):
    """Archive with one member changed, and its checksum right; sometimes its bytes."""
    if rng.random() < 0.3:
        return of_bytes(rng, data)
    result = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(result, "w", 8) as changed:
        names = [n for n in archive.namelist() if not n.endswith((".so", ".dylib", ".c", ".h"))]
        chosen = rng.choice([n for n in names if n.endswith((".xml", ".npy"))] or names)
        for name in archive.namelist():
            content = archive.read(name)
            if name == chosen:
                text = name.endswith(".xml") and rng.random() < 0.8
                content = (of_text if text else of_bytes)(rng, content)
            if rng.random() < 0.97:
                changed.writestr(rng.choice((name,) * 60 + (f"../{name}", "/a")), content)
    return result.getvalue()


def of_matlab(rng, data):
    """MAT-file with changed bytes, also inside of a compressed variable."""
    if int.from_bytes(data[128:132], "little") != 15 or rng.random() < 0.3:
        return of_bytes(rng, data)
    size = int.from_bytes(data[132:136], "little")
    packed = zlib.compress(of_bytes(rng, zlib.decompress(data[136 : 136 + size])))
    head = data[:132] + len(packed).to_bytes(4, "little")
    return (head + packed + data[136 + size :])[:LONGEST]


def of_log(rng, data, metadata, messages):
    """Log with changed bytes, or written anew with changed metadata or ticks."""
    if rng.random() < 0.4:
        return of_bytes(rng, data)
    from mcap.writer import CompressionType, Writer

    from firmware_py.log.recording import METADATA, TOPIC

    metadata, messages = dict(metadata), list(messages)
    if rng.random() < 0.5:
        key = rng.choice(list(metadata))
        changed = rng.choice((of_text, of_json))(rng, metadata[key].encode())
        metadata[rng.choice((key, key, key, "motion"))] = changed.decode("utf-8", "replace")
    else:
        at = rng.randrange(len(messages))
        messages[at] = (messages[at][0], rng.choice((of_text, of_json))(rng, messages[at][1]))
    stream = io.BytesIO()
    writer = Writer(stream, compression=rng.choice(list(CompressionType)))
    writer.start()
    writer.add_metadata(METADATA, metadata)
    channel = writer.register_channel(TOPIC, "json", writer.register_schema("s", "jsonschema", b""))
    for k, (time_ns, message) in enumerate(messages):
        writer.add_message(channel, time_ns, message, time_ns, k)
    writer.finish()
    return stream.getvalue()


def of_bag(rng, files):
    """Bag with a changed file, or with a changed message in a sound database."""
    base = next(name for name in files if name.endswith(".db3"))
    kind = rng.randrange(4)
    if kind == 0:
        name = "bag/metadata.yaml"
        return {name: one_of(of_text, of_bytes)(rng, files[name])}
    if kind == 1:
        return {base: of_bytes(rng, files[base])}
    file = sqlite3.connect(":memory:")
    file.deserialize(files[base])
    rows = file.execute("SELECT id, data FROM messages").fetchall()
    for row, content in rng.sample(rows, rng.choice((1, 2, 5))):
        changed = (of_bytes(rng, content), row)
        file.execute("UPDATE messages SET data = ? WHERE id = ?", changed)
    if kind == 3:
        column = rng.choice(("name", "type", "serialization_format", "offered_qos_profiles"))
        value = of_text(rng, b"sensor_msgs/msg/JointState").decode("utf-8", "replace")
        file.execute(f"UPDATE topics SET {column} = ? WHERE id = 1", (value,))
    file.commit()
    return {base: file.serialize()}


def of_takes(rng, files):
    """Changed table of takes, or changed rules in the map."""
    if rng.random() < 0.5:
        return {"takes.csv": of_text(rng, files["takes.csv"])}
    return {"map.toml": toml_file(rng, files["map.toml"])}


def takes_of_folder(folder):
    from models.trials.recordings.mapping import find_takes, read_mapping

    find_takes([folder], "table", read_mapping(folder / "map.toml"))


def every_reader(bundle=None):
    """Every reader; those of a bundle have no valid files where no directory of one is given."""
    return [
        *_recordings(), *_documents(), *_outside_goals_and_signatures(), *_bundle_files(bundle),
        *_commands(bundle),
    ]  # fmt: skip


def _recordings():
    from models.trials.files import read_trial

    trial, (columns, map_) = valid_files.trial(), valid_files.table()
    csv = valid_files.csv_of(columns).encode()
    more = {"map.toml": map_, "servo.csv": csv}
    bare = b"step_s = 0.017\n" + map_[map_.index(b"[trial]") :]

    def imported(name, kind, file, content, mutation, servo=None):
        files = {file: content} | more
        return FuzzReader(name, files, one(file, mutation), importing(kind, file, servo))

    for file, mutation in (("run.csv", of_text), ("run.toml", toml_file)):
        yield FuzzReader(
            f"trial {file[4:]}", trial, one(file, mutation), lambda f: read_trial(f / "run.csv")
        )
    yield imported("table csv", "table", "a.csv", csv, one_of(of_text, of_text, of_bytes))
    servo_map = map_.replace(b"[columns", b"[servo_columns")
    yield FuzzReader(
        "table qtm", {"a.tsv": valid_files.qtm(), "map.toml": servo_map, "servo.csv": csv},
        one("a.tsv", of_text), importing("table", "a.tsv", "servo.csv"),
    )  # fmt: skip
    entry = map_.replace(b'"stamp"', b'"entries[].stamp"')
    json = FuzzReader(
        "table json", {"a.json": valid_files.json_of(columns), "map.toml": entry},
        one("a.json", of_json), importing("table", "a.json"),
    )  # fmt: skip
    yield json
    for form in ("5", "5c", "4"):
        content = valid_files.matlab_of(columns, form)
        yield imported(f"mat {form}", "table", "a.mat", content, of_matlab)
    yield imported(
        "motive", "motive", "a.csv", valid_files.motive(), one_of(of_text, of_text, of_bytes),
        "servo.csv",
    )  # fmt: skip
    yield imported("c3d", "c3d", "a.c3d", valid_files.c3d(), of_bytes, "servo.csv")
    yield FuzzReader(
        "bag", valid_files.bag() | {"map.toml": map_}, of_bag, importing("rosbag", "bag")
    )
    data, metadata, messages = valid_files.log()
    yield FuzzReader(
        "mcap", {"a.mcap": data, "map.toml": bare},
        one("a.mcap", lambda rng, own: of_log(rng, own, metadata, messages)),
        importing("recording", "a.mcap"),
    )  # fmt: skip
    yield FuzzReader("takes", valid_files.takes(), of_takes, takes_of_folder)
    yield FuzzReader(
        "map", {"a.csv": csv, "map.toml": map_}, one("map.toml", toml_file),
        importing("table", "a.csv"),
    )  # fmt: skip


def _documents():
    from firmware_py.config import read_config
    from firmware_py.core.documents import read_document
    from firmware_py.core.motion import read_motion_document
    from firmware_py.goals.goal_map import read_goal_map
    from firmware_py.goals.tip_plan import read_tip_plan
    from firmware_py.link.link_description import read_link
    from firmware_py.summary import RunDocument
    from models.gap.report.gap_json import GapDocument, read_gap_document
    from models.plan.paths import read_path
    from models.plant.plant import read_plant
    from models.rig.drawn import rig_named
    from models.rig.parameters import RIG_TOML, read_parameters

    def document(name, file, content, mutation, read):
        return FuzzReader(name, {file: content}, one(file, mutation), lambda f: read(f / file))

    root = valid_files.ROOT
    nominal = root / "models" / "plant" / "nominal.toml"
    pendulum = root / "models" / "plant" / "examples" / "xl330_pendulum_identified.json"
    motion = (
        b"schema = 1\nduration_s = 10.0\nharmonics = [1, 2, 5]\n[[joints]]\n"
        b"sine_rad = [0.2, -0.1, 0.02]\ncosine_rad = [0.1, 0.0, 0.01]\n"
    )
    path = b"time_s,x_m,y_m\n0,0,0\n0.5,0.1,0\n1.0,0.1,0.1\n1.5,0,0\n"

    def robot(file):
        config = read_config(file)
        config.goals_rad()
        config.goals_rad(repeated=True)

    def link(file):
        read_link(file)
        read_plant(file)
        rig_named(str(file))

    yield document("robot.toml", "robot.toml", (root / "robot.toml").read_bytes(), toml_file, robot)
    yield document("plant toml", "a.toml", nominal.read_bytes(), toml_file, read_plant)
    yield document("plant json", "a.json", pendulum.read_bytes(), of_json, read_plant)
    yield document("rig", "a.toml", RIG_TOML.read_bytes(), toml_file, read_parameters)
    yield document("motion", "a.toml", motion, toml_file, read_motion_document)
    yield document("plan", "a.json", valid_files.plan(), of_json, read_tip_plan)
    yield document("path", "a.csv", path, of_text, lambda file: read_path(file, 2, 0.017))
    for name, kind, read in (
        ("gap.json", GapDocument, read_gap_document),
        ("summary", RunDocument, lambda file: read_document(file, RunDocument)),
    ):  # fmt: skip
        yield document(name, "a.json", valid_files.example_of(kind), of_json, read)
    yield document("goalmap", "a.json", valid_files.goal_map(), of_json, read_goal_map)
    yield document("link", "a.toml", valid_files.link(), toml_file, link)


def _outside_goals_and_signatures():
    from firmware_py.core.input_files import content_of
    from firmware_py.goals.goal_channel import decode_goal
    from firmware_py.inference.bundle_signature import check_signature

    def goal(file):
        said = decode_goal(file.read_bytes(), 1)
        if isinstance(said, str):
            raise InputError("the message", said, "mend the program")

    message = one("a", one_of(of_json, of_text, of_bytes))
    content = {"a": valid_files.goal_message()}
    yield FuzzReader("goal message", content, message, lambda f: goal(f / "a"))
    trusted, manifest, signature = valid_files.signature()
    yield FuzzReader(
        "signature", {"manifest.json": manifest, "manifest.sig": signature},
        one("manifest.sig", of_json),
        lambda f: check_signature(content_of(f / "manifest.json"), f / "manifest.sig", (trusted,)),
    )  # fmt: skip


def _bundle_files(bundle):
    from firmware_py.inference.bundle import ModelBundle, read_manifest
    from firmware_py.inference.fmu_instance import open_fmu
    from firmware_py.inference.golden import read_golden
    from firmware_py.inference.predictor import OnnxPredictor

    found = sorted(Path(bundle).iterdir()) if bundle else []
    files = {p.name: p.read_bytes() for p in found if p.is_file()}

    def document(name, file, mutation, read):
        content = {file: files.get(file, b"")}
        return FuzzReader(name, content, one(file, mutation), lambda f: read(f / file))

    def manifest(folder):
        read_manifest(folder)
        ModelBundle.load(folder)

    yield FuzzReader("manifest", files, one("manifest.json", _with_own_hash), manifest)
    yield document("npz", "golden.npz", of_zip, lambda file: read_golden(file, 1))
    yield document("onnx", "predictor.onnx", of_bytes, lambda file: OnnxPredictor(file, 1))
    yield document("fmu", "observer.fmu", of_zip, open_fmu)


def _with_own_hash(rng, data):
    """A changed manifest whose own hash fits, which would refuse every change before."""
    changed = of_json(rng, data)
    try:
        document = json.loads(changed)
        fitting = {"content_sha256": content_sha256(document)}
        return json.dumps(document | fitting).encode()
    except (ValueError, AttributeError, TypeError, RecursionError):
        return changed


def _commands(bundle):
    from models.commands.sign import read_key

    def document(name, file, content, mutation, read):
        return FuzzReader(name, {file: content}, one(file, mutation), lambda f: read(f / file))

    robot = (valid_files.ROOT / "robot.toml").read_bytes()
    spec = command_readers.CAMPAIGN
    yield document("campaign", "a.toml", spec, toml_file, command_readers.campaign)
    results = command_readers.results_of_campaign()
    yield FuzzReader("results", results, _one_of_files, command_readers.campaign_results)
    for name, file, content, read in command_readers.documents():
        yield document(name, file, content, of_json, read)
    text = one_of(of_text, of_bytes)
    for form in ("PKCS8", "OpenSSH"):
        key = command_readers.key_file(form)
        yield document(f"key {form}", "a.pem", key, text, read_key)
    files = command_readers.plan_run()
    yield FuzzReader("plan run", files, _one_of_files, command_readers.run_of_plan)
    gains = robot.replace(b"# gains", b"gains")
    yield document("limits", "robot.toml", gains, toml_file, command_readers.limits_of_robot)
    yield document("service", "robot.toml", robot, toml_file, command_readers.install)
    message = one_of(of_json, of_text, of_bytes)
    status = valid_files.status_message()
    yield document("status", "a", status, message, command_readers.status_message)
    fmu = (bundle / "observer.fmu").read_bytes() if bundle else b""
    yield document(
        "fmu check", "a.fmu", fmu, command_readers.of_fmu_parts, command_readers.foreign_fmu
    )
    data, metadata, messages = valid_files.log()
    yield FuzzReader(
        "replay", {"a.mcap": data if bundle else b""},
        one("a.mcap", lambda rng, own: of_log(rng, own, metadata, messages)),
        command_readers.replayed(bundle),
    )  # fmt: skip


def _one_of_files(rng, files):
    name = rng.choice(sorted(files))
    mutation = {"json": of_json, "toml": toml_file}.get(name.rpartition(".")[2], of_text)
    return {name: mutation(rng, files[name])}
