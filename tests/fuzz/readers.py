"""Readers that the fuzzer feeds: valid files, their mutation, and the call that reads them."""

import io
import itertools
import json
import random
import sqlite3
import tomllib
import zipfile
import zlib
from argparse import ArgumentParser
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

from mcap.writer import CompressionType, Writer

from firmware_py.commands.install_service import service_file
from firmware_py.commands.replay import compare
from firmware_py.config import read_config
from firmware_py.core.documents import read_document
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import content_of
from firmware_py.core.motion import read_motion_document
from firmware_py.goals.goal_channel import decode_goal
from firmware_py.goals.goal_map import read_goal_map
from firmware_py.goals.tip_plan import read_tip_plan
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.bundle_signature import check_signature
from firmware_py.inference.fmu_instance import open_fmu
from firmware_py.inference.golden import read_golden
from firmware_py.inference.manifest import content_sha256
from firmware_py.inference.predictor import OnnxPredictor
from firmware_py.link.link_description import read_link
from firmware_py.log.recording import METADATA, TOPIC, read_recording
from firmware_py.summary import RunDocument
from fmu.documents import read_reference_run
from fmu.fmpy_instance import FmuArchive
from fmu.fmu_models import embedded_parts
from hil.campaign.cases import CaseMaker
from hil.campaign.kinds.case_kind import KINDS, load_kind
from hil.campaign.specification import configurations, read_spec
from models.commands import import_
from models.commands.sign import read_key
from models.gap.report.gap_json import GapDocument, read_gap_document
from models.plan.learning import read_plan_run
from models.plan.paths import read_path
from models.plant.plant import read_plant
from models.rig.drawn import rig_named
from models.rig.parameters import RIG_TOML, read_parameters
from models.study.document import StudyDocument, read_study
from models.trials.files import read_trial
from models.trials.recordings.mapping import find_takes, read_mapping
from tests.fuzz import valid_files
from tests.fuzz.mutations import LONGEST, of_bytes, of_json, of_text, of_toml

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


def every_reader(bundle=None):
    """Every reader; those of a bundle have no valid files where no directory of one is named."""
    return [*_recordings(), *_documents(), *_of_bundle(bundle)]


# --- mutations of a format ------------------------------------------------------------------------


def toml_file(rng, data):
    return of_toml(rng, data, tomllib.loads)


def one(name, mutation):
    """Mutation of one file."""
    return lambda rng, files: {name: mutation(rng, files[name])}


def one_of(*mutations):
    return lambda rng, data: rng.choice(mutations)(rng, data)


def of_any_file(rng, files):
    name = rng.choice(sorted(files))
    mutation = {"json": of_json, "toml": toml_file}.get(name.rpartition(".")[2], of_text)
    return {name: mutation(rng, files[name])}


def of_zip(rng, data):
    """Archive with one member changed, and its checksum right; sometimes its bytes."""
    if rng.random() < 0.3:
        return of_bytes(rng, data)
    result = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(result, "w", 8) as changed:
        names = [n for n in archive.namelist() if not n.endswith((".so", ".dylib", ".c", ".h"))]
        chosen = rng.choice(names)
        for name in archive.namelist():
            content = archive.read(name)
            if name == chosen:
                mutation = {"xml": of_text, "json": of_json, "csv": of_text}
                content = mutation.get(name.rpartition(".")[2], of_bytes)(rng, content)
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
    metadata, messages = dict(metadata), list(messages)
    if rng.random() < 0.5:
        key = rng.choice(list(metadata))
        changed = rng.choice((of_text, of_json))(rng, metadata[key].encode())
        metadata[rng.choice((key, key, key, "motion"))] = changed.decode("utf-8", "replace")
    else:
        at = rng.randrange(len(messages))
        messages[at] = rng.choice((of_text, of_json))(rng, messages[at])
    return written_log(metadata, messages, rng.choice(list(CompressionType)))


def written_log(metadata, messages, compression=CompressionType.LZ4):
    """Log with metadata and ticks as they are, right or wrong."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=compression)
    writer.start()
    writer.add_metadata(METADATA, metadata)
    channel = writer.register_channel(TOPIC, "json", writer.register_schema("s", "jsonschema", b""))
    for k, message in enumerate(messages):
        writer.add_message(channel, k, message, k, k)
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


# --- recordings -----------------------------------------------------------------------------------


def importing(kind, name, servo=None):
    """Import of a file by the command, without its console."""

    def read(folder):
        parser = ArgumentParser()
        import_.configure(parser)
        parser.add_argument("--json", action="store_true")
        more = ["--servo", str(folder / servo), "--offset", "0"] if servo else []
        argv = [str(folder / name), "--as", kind, "--map", str(folder / "map.toml"), *more]
        import_.run(parser.parse_args([*argv, "--name", "trial", "--out", str(folder / "out")]))

    return read


def _recordings():
    trial, (columns, map_) = valid_files.trial(), valid_files.table()
    csv = valid_files.csv_of(columns).encode()
    text = one_of(of_text, of_text, of_bytes)
    servo_map = map_.replace(b"[columns", b"[servo_columns")
    entries = map_.replace(b'"stamp"', b'"entries[].stamp"')
    data, metadata, messages = valid_files.log()

    def imported(name, kind, file, content, mutation, servo=None, map_=map_):
        files = {file: content, "map.toml": map_, "servo.csv": csv}
        return FuzzReader(name, files, one(file, mutation), importing(kind, file, servo))

    yield FuzzReader("trial", trial, of_any_file, lambda folder: read_trial(folder / "run.csv"))
    yield imported("table csv", "table", "a.csv", csv, text)
    yield imported(
        "table qtm", "table", "a.tsv", valid_files.qtm(), of_text, "servo.csv", servo_map
    )
    content = valid_files.json_of(columns)
    yield imported("table json", "table", "a.json", content, of_json, map_=entries)
    for form in ("5", "5c", "4"):
        content = valid_files.matlab_of(columns, form)
        yield imported(f"mat {form}", "table", "a.mat", content, of_matlab)
    yield imported("motive", "motive", "a.csv", valid_files.motive(), text, "servo.csv")
    yield imported("c3d", "c3d", "a.c3d", valid_files.c3d(), of_bytes, "servo.csv")
    bag = valid_files.bag() | {"map.toml": map_}
    yield FuzzReader("bag", bag, of_bag, importing("rosbag", "bag"))
    yield imported(
        "mcap", "recording", "a.mcap", data, lambda rng, own: of_log(rng, own, metadata, messages),
        map_=b"step_s = 0.017\n" + map_[map_.index(b"[trial]") :],
    )  # fmt: skip
    yield FuzzReader(
        "takes", valid_files.takes(), of_any_file,
        lambda folder: find_takes([folder], "table", read_mapping(folder / "map.toml")),
    )  # fmt: skip
    files = {"a.csv": csv, "map.toml": map_}
    yield FuzzReader("map", files, one("map.toml", toml_file), importing("table", "a.csv"))


# --- documents ------------------------------------------------------------------------------------


def document(name, file, content, mutation, read):
    return FuzzReader(name, {file: content}, one(file, mutation), lambda f: read(f / file))


def _robot(file):
    config = read_config(file)
    config.goals_rad()
    config.goals_rad(repeated=True)
    assert config.limits_in_force
    # No value of the file adds a line to the unit of the service.
    text = service_file(config, file, "robot", frozenset({0, 1}))
    assert len(text.splitlines()) - text.count("BindReadOnlyPaths=/") == _service_lines()


@cache
def _service_lines():
    path = valid_files.ROOT / "robot.toml"
    return len(service_file(read_config(path), path, "robot").splitlines())


def _link(file):
    read_link(file)
    read_plant(file)
    rig_named(str(file))


def _campaign(file):
    """Campaign's file and the first of its cases."""
    spec = read_spec(file)
    if spec.kind not in KINDS:  # a module that the file names is run, whatever it is
        raise InputError(file, "names a module", "name a kind")
    maker = CaseMaker(*load_kind(spec.kind), file.parent / "shared")
    maker.cases(itertools.islice(configurations(spec), 20), str(file))


def _goal(file):
    answer = decode_goal(file.read_bytes(), 1)
    if isinstance(answer, str):
        raise InputError("the message", answer, "mend the program")


def _documents():
    root, any_form = valid_files.ROOT, one_of(of_json, of_text, of_bytes)
    nominal = (root / "models" / "plant" / "nominal.toml").read_bytes()
    pendulum = root / "models" / "plant" / "examples" / "xl330_pendulum_identified.json"
    example = valid_files.example_of
    yield document("robot.toml", "a.toml", (root / "robot.toml").read_bytes(), toml_file, _robot)
    yield document("plant toml", "a.toml", nominal, toml_file, read_plant)
    yield document("plant json", "a.json", pendulum.read_bytes(), of_json, read_plant)
    yield document("rig", "a.toml", RIG_TOML.read_bytes(), toml_file, read_parameters)
    yield document("motion", "a.toml", valid_files.MOTION, toml_file, read_motion_document)
    yield document("link", "a.toml", valid_files.link(), toml_file, _link)
    yield document("plan", "a.json", valid_files.plan(), of_json, read_tip_plan)
    yield document("path", "a.csv", valid_files.PATH, of_text, lambda f: read_path(f, 2, 0.017))
    yield document("goalmap", "a.json", valid_files.goal_map(), of_json, read_goal_map)
    yield document("gap.json", "a.json", example(GapDocument), of_json, read_gap_document)
    yield document("study", "a.json", example(StudyDocument), of_json, read_study)
    yield document(
        "summary", "a.json", example(RunDocument), of_json, lambda f: read_document(f, RunDocument)
    )
    yield document("campaign", "a.toml", valid_files.CAMPAIGN, toml_file, _campaign)
    yield document("goal message", "a", valid_files.goal_message(), any_form, _goal)
    key = one_of(of_text, of_bytes)
    yield document("key", "a.pem", valid_files.key_file(), key, read_key)
    trusted, manifest, signature = valid_files.signature()
    yield FuzzReader(
        "signature", {"manifest.json": manifest, "manifest.sig": signature},
        one("manifest.sig", of_json),
        lambda f: check_signature(content_of(f / "manifest.json"), f / "manifest.sig", (trusted,)),
    )  # fmt: skip
    yield FuzzReader(
        "plan run", valid_files.plan_run(), of_any_file,
        lambda f: read_plan_run(f / "run.csv", read_tip_plan(f / "plan.json")),
    )  # fmt: skip


# --- files of a bundle ----------------------------------------------------------------------------


def _of_bundle(bundle):
    files = (
        {p.name: p.read_bytes() for p in Path(bundle).iterdir() if p.is_file()} if bundle else {}
    )
    loaded = cache(lambda: ModelBundle.load(bundle))
    data, metadata, messages = valid_files.log()

    def of(name, file, mutation, read):
        return document(name, file, files.get(file, b""), mutation, read)

    def manifest(folder):
        read_manifest(folder)
        ModelBundle.load(folder)

    def foreign_fmu(file):
        """As `fmu check` reads it before its library is loaded."""
        with FmuArchive(file) as archive:
            embedded_parts(archive.directory / "resources")
            read_reference_run(archive.directory)

    yield FuzzReader("manifest", files, one("manifest.json", _with_own_hash), manifest)
    yield of("npz", "golden.npz", of_zip, lambda file: read_golden(file, 1))
    yield of("onnx", "predictor.onnx", of_bytes, lambda file: OnnxPredictor(file, 1))
    yield of("fmu", "observer.fmu", of_zip, open_fmu)
    yield of("fmu check", "observer.fmu", of_zip, foreign_fmu)
    yield document(
        "replay", "a.mcap", data if bundle else b"",
        lambda rng, own: of_log(rng, own, metadata, messages),
        lambda file: compare(read_recording(file), loaded()),
    )  # fmt: skip


def _with_own_hash(rng, data):
    """A changed manifest whose own hash fits, which would refuse every change before."""
    changed = of_json(rng, data)
    try:
        tree = json.loads(changed)
        return json.dumps(tree | {"content_sha256": content_sha256(tree)}).encode()
    except (ValueError, AttributeError, TypeError, RecursionError):
        return changed
