"""The command refuses what it cannot use, in one sentence."""

import msgspec
import pytest

from dropstitch.__main__ import main
from models.gap.report.gap_json import DiagnosisInputs, write_gap_document
from models.gap.report.gap_results import gap_document
from models.trials.files import write_trial


@pytest.mark.parametrize(
    ("out", "said"), [("gap.json", "no TOML file"), ("gap.toml", "is a file that is read")]
)
def test_the_diagnosis_is_not_overwritten(tmp_path, capsys, out, said):
    for name in ("gap.json", "gap.toml"):
        (tmp_path / name).write_text("kept")
    code = main(["experiment", "--gap", str(tmp_path / out), "--config", "robot.toml",
                 "--out", str(tmp_path / out)])  # fmt: skip
    assert code == 2
    assert said in capsys.readouterr().err
    assert (tmp_path / out).read_text() == "kept"


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
    code = main(["experiment", "--gap", str(tmp_path / "none.json"), "--config", "robot.toml",
                 "--out", str(tmp_path / "motion.toml"), *options])  # fmt: skip
    assert code == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert sentence in told
    assert not (tmp_path / "motion.toml").exists()


@pytest.fixture
def diagnosis(late, toy_trials, tmp_path):
    """Function that writes plant, trials and a diagnosis of them, and returns its file."""
    found, trials = late

    def write(directory, trials_sha256=""):
        for trial in toy_trials(1):
            write_trial(trial, directory)
        found.plant.write(tmp_path / "plant.toml")
        inputs = DiagnosisInputs(
            str(tmp_path / "plant.toml"), "", (str(directory),), trials_sha256, dof=1
        )
        document = msgspec.structs.replace(gap_document(found, trials), inputs=inputs)
        write_gap_document(tmp_path / "gap.json", document)
        return tmp_path / "gap.json"

    return write


def test_trials_that_were_changed_are_refused(diagnosis, tmp_path, capsys):
    gap = diagnosis(tmp_path / "trials", "0" * 64)
    code = main(["experiment", "--gap", str(gap), "--config", "robot.toml",
                 "--out", str(tmp_path / "motion.toml")])  # fmt: skip
    assert code == 2
    assert "are not the trials of this diagnosis" in capsys.readouterr().err


@pytest.mark.parametrize("out", ["m.toml", "plant.toml", "m/trials/TRIAL.toml"])
def test_a_repetition_touches_nothing_of_the_diagnosis(
    diagnosis, toy_trials, tmp_path, capsys, monkeypatch, out
):
    gap = diagnosis(tmp_path / "m" / "trials")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    monkeypatch.setattr(
        "models.gap.experiment.experiment.design_experiment", lambda *_: pytest.fail("designed")
    )
    out = tmp_path / out.replace("TRIAL", toy_trials(1)[0].name)
    code = main(["experiment", "--gap", str(gap), "--config", "robot.toml", "--repeat",
                 "--out", str(out)])  # fmt: skip
    assert code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "read; name another file" in said
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
