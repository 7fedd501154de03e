"""Readers of single commands for the fuzzer: campaign, documents of a report, key, replay."""

import io
import itertools
import json
import zipfile
from functools import cache
from pathlib import Path

import msgspec

from firmware_py.core.errors import InputError
from tests.fuzz import valid_files
from tests.fuzz.mutations_of_files import of_bytes, of_json, of_text

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
COSTS = """key,code,state,wall_s,cpu_s,memory_bytes,worker
a,c,done,0.5,0.4,100000000,host-1
b,c,done,0.3,0.2,100000000,host-1
d,c,failed,0.3,0.2,100000000,host-2
"""


def campaign(file):
    """Campaign's file and the first of its cases."""
    from hil.campaign.cases import CaseMaker
    from hil.campaign.kinds.case_kind import KINDS, load_kind
    from hil.campaign.specification import configurations, read_spec

    spec = read_spec(file)
    if spec.kind not in KINDS:  # a module that the file names is run, whatever it is
        raise InputError(file, "names a module", "name a kind")
    maker = CaseMaker(*load_kind(spec.kind), file.parent / "shared")
    maker.cases(itertools.islice(configurations(spec), 20), str(file))


def campaign_results(folder):
    """What an interrupted campaign has left: a result, a failure, the table of costs."""
    from hil.campaign.page import costs_part
    from hil.campaign.store import ResultStore

    store = ResultStore(folder)
    store.read("ab")
    store.last_failure("ab")
    costs_part(store.read_costs("c"), "c")


def results_of_campaign():
    from hil.campaign.store import CaseRecord, FailureRecord

    record = valid_files.example_of(CaseRecord)
    failure = json.loads(valid_files.example_of(FailureRecord)) | {"key": "ab"}
    return {
        "results/ab/ab.json": record, "costs.csv": COSTS.encode(),
        "failures/ab-1.json": json.dumps(failure).encode(),
    }  # fmt: skip


def key_file(form):
    """Private key of a form of the library, not encrypted."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key = Ed25519PrivateKey.from_private_bytes(bytes(32))
    return key.private_bytes(
        serialization.Encoding.PEM, getattr(serialization.PrivateFormat, form),
        serialization.NoEncryption(),
    )  # fmt: skip


def documents():
    """Documents that `hil report` and the rig read: name, file, content, and what reads it."""
    from hil.faults.faults_document import FaultsDocument, read_faults
    from hil.sil.timing_document import TimingDocument, read_timing
    from models.predictor.document import PredictorsDocument, read_predictors
    from models.rig.protocol import CONDITIONS_FILE, ConditionsRecord, record_conditions
    from models.study.document import StudyDocument, read_study

    def example(kind, **values):
        return json.dumps(json.loads(valid_files.example_of(kind)) | values).encode()

    yield "faults", "a.json", example(FaultsDocument, counts={"pass": 1}), read_faults
    yield "timing", "a.json", example(TimingDocument, causes={}), read_timing
    yield "study", "a.json", example(StudyDocument), read_study
    yield "predictors", "a.json", example(PredictorsDocument), read_predictors
    yield (
        "conditions", CONDITIONS_FILE, example(ConditionsRecord),
        lambda file: record_conditions((), None, file.parent),
    )  # fmt: skip


def plan_run():
    """Plan, and a trial of three runs of it."""
    plan, trial = valid_files.plan(), valid_files.trial()
    goals = json.loads(plan)["payloads"][0]["goals_rad"][0] * 3
    head = trial["run.csv"].split(b"\n", 1)[0].decode()
    width = len(head.split(",")) - 3
    rows = [",".join([f"{0.017 * k:.6g}", *[f"{g:.6g}"] * 2, *["0.1"] * width])
            for k, g in enumerate(goals)]  # fmt: skip
    return trial | {"plan.json": plan, "run.csv": "\n".join([head, *rows]).encode()}


def run_of_plan(folder):
    from firmware_py.goals.tip_plan import read_tip_plan
    from models.plan.learning import read_plan_run

    read_plan_run(folder / "run.csv", read_tip_plan(folder / "plan.json"))


def limits_of_robot(file):
    from firmware_py.config import read_config
    from models.commands.identify import read_servo_gains

    assert read_config(file).limits_in_force
    read_servo_gains(file)


def status_message(file):
    """Message of the robot to a program that sends goals."""
    from firmware_py.goals.goal_channel import StatusMessage

    try:
        msgspec.json.decode(file.read_bytes(), type=StatusMessage)
    except (ValueError, RecursionError) as error:
        raise InputError("the message", f"is damaged ({error})", "mend the program") from None


def foreign_fmu(file):
    """FMU as `fmu check` reads it before its library is loaded."""
    from fmu.documents import read_reference_run
    from fmu.fmpy_instance import FmuArchive
    from fmu.fmu_models import embedded_parts

    with FmuArchive(file) as archive:
        embedded_parts(archive.directory / "resources")
        read_reference_run(archive.directory)


def of_fmu_parts(rng, data):
    """FMU with a changed file of kind, plant, graph or reference run."""
    result = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(result, "w") as changed:
        parts = [n for n in archive.namelist() if n.endswith((".json", ".onnx", ".csv"))]
        chosen = rng.choice(parts)
        mutation = {"json": of_json, "onnx": of_bytes, "csv": of_text}[chosen.rpartition(".")[2]]
        for name in archive.namelist():
            content = archive.read(name)
            changed.writestr(name, mutation(rng, content) if name == chosen else content)
    return result.getvalue()


@cache
def _bundle(directory):
    from firmware_py.inference.bundle import ModelBundle

    return ModelBundle.load(directory)


def replayed(directory):
    """Log as `dropstitch replay` compares it with a bundle that is sound."""

    def read(folder):
        from firmware_py.commands.replay import compare
        from firmware_py.log.recording import read_recording

        compare(read_recording(Path(folder, "a.mcap")), _bundle(directory))

    return read


def install(file):
    """Unit of the service for a robot, in which no value adds a line."""
    from firmware_py.commands.install_service import service_file
    from firmware_py.config import read_config

    text = service_file(read_config(file), file, "robot", frozenset({0, 1}))
    assert len(text.splitlines()) - text.count("BindReadOnlyPaths=/") == _service_lines()


@cache
def _service_lines():
    from firmware_py.commands.install_service import service_file
    from firmware_py.config import read_config

    path = valid_files.ROOT / "robot.toml"
    return len(service_file(read_config(path), path, "robot").splitlines())
