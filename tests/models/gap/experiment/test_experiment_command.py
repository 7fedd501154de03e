"""The command: what it writes, and what it refuses in one sentence."""

import json

import pytest
from msgspec import inspect

from dropstitch.__main__ import main
from firmware_py.core.motion import Motion, MotionConfig
from models.gap.report.gap_json import GapDocument
from models.plant.plant import read_plant
from models.rig.parameters import read_rig
from models.rig.protocol import TrialCase, run_case
from models.trials.files import write_trial

HYPOTHESES = [
    {"effects": ["dead_time"], "probability": 0.6, "parameters": {"dead_time_1_s": 0.02}},
    {"effects": ["sync_offset"], "probability": 0.4, "parameters": {"sync_offset_s": -0.02}},
]


def smallest(kind):
    """Least content of a type: required fields alone, nothing in a container."""
    match kind:
        case inspect.StructType():
            return {f.name: smallest(f.type) for f in kind.fields if f.required}
        case inspect.LiteralType():
            return kind.values[0]
        case inspect.DictType():
            return {}
        case inspect.VarTupleType():
            return []
        case inspect.StrType():
            return ""
        case inspect.BoolType():
            return False
    return 0


@pytest.fixture(scope="session")
def rig_trial():
    case = TrialCase(Motion(amplitude_rad=0.3, period_s=2.6), 1.0, trial=1)
    return run_case(read_rig("default"), case)


@pytest.fixture
def diagnosis(rig_trial, tmp_path):
    """Function that writes plant, trial and the document of a diagnosis, and returns its file."""

    def write(directory, trials_sha256="", plant_sha256=""):
        write_trial(rig_trial, directory)
        plant = tmp_path / "plant.toml"
        read_plant().write(plant)
        document = smallest(inspect.type_info(GapDocument)) | {
            "schema": GapDocument.VERSION,
            "hypotheses": HYPOTHESES,
            "inputs": {
                "plant": str(plant), "plant_sha256": plant_sha256, "trials": [str(directory)],
                "trials_sha256": trials_sha256, "dof": 1,
            },
        }  # fmt: skip
        (tmp_path / "gap.json").write_text(json.dumps(document))
        return tmp_path / "gap.json"

    return write


def experiment(gap, out, *options):
    return main(
        ["experiment", "--gap", str(gap), "--config", "robot.toml", "--out", str(out), *options]
    )


@pytest.mark.slow
def test_the_command_writes_the_best_motion_and_its_page(diagnosis, tmp_path, capsys):
    out = tmp_path / "motion.toml"
    gap = diagnosis(tmp_path / "trials")
    assert experiment(gap, out, "--payloads", "1", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    first = result["ranking"][0]
    motion = MotionConfig().with_motion(str(out)).motion(1)
    assert (motion.kind, motion.period_s) == (first["kind"], first["period_s"])
    assert first["payload_kg"] == 1.0
    assert first["separation"].keys() == result["separation_now"].keys()
    assert "dead time" in (tmp_path / "motion.html").read_text()


@pytest.mark.parametrize(
    ("out", "sentence"), [("gap.json", "no TOML file"), ("gap.toml", "is a file that is read")]
)
def test_the_diagnosis_is_not_overwritten(tmp_path, capsys, out, sentence):
    for name in ("gap.json", "gap.toml"):
        (tmp_path / name).write_text("before")
    assert experiment(tmp_path / out, tmp_path / out) == 2
    assert sentence in capsys.readouterr().err
    assert (tmp_path / out).read_text() == "before"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--hide", "creep=0.1"], "--repeat"),
        ([], "none.json"),
        (["--seed", "-1"], "--seed -1: is out of range; choose 0 to 4294967295"),
        (["--seed", "4294967296", "--repeat"], "--seed 4294967296: is out of range"),
    ],
)
def test_wrong_options_give_one_sentence(tmp_path, capsys, options, sentence):
    assert experiment(tmp_path / "none.json", tmp_path / "motion.toml", *options) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and sentence in error
    assert not (tmp_path / "motion.toml").exists()


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ("trials_sha256", "are not the trials of this diagnosis"),
        ("plant_sha256", "is not the plant of this diagnosis"),
    ],
)
def test_inputs_that_were_changed_are_refused(diagnosis, tmp_path, capsys, changed, sentence):
    gap = diagnosis(tmp_path / "trials", **{changed: "0" * 64})
    assert experiment(gap, tmp_path / "motion.toml") == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize(
    ("out", "sentence"),
    [
        ("m.toml", "trials: is not empty; remove it, or name another --out"),
        ("plant.toml", "is a file that is read; name another file"),
        ("m/trials/TRIAL.toml", "is a file that is read; name another file"),
    ],
)
def test_a_repetition_replaces_nothing_of_the_diagnosis(
    diagnosis, rig_trial, tmp_path, capsys, out, sentence
):
    gap = diagnosis(tmp_path / "m" / "trials")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert experiment(gap, tmp_path / out.replace("TRIAL", rig_trial.name), "--repeat") == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and sentence in error
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
