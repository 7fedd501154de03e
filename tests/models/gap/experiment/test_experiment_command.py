"""The command refuses what it cannot use, in one sentence."""

import msgspec
import pytest

from models.__main__ import main
from models.gap.report.gap_json import DiagnosisInputs, write_gap_document
from models.gap.report.gap_results import gap_document
from models.trials.trial_files import write_trial


@pytest.mark.parametrize(
    ("out", "said"), [("gap.json", "no TOML file"), ("gap.toml", "is a file that is read")]
)
def test_the_diagnosis_is_not_overwritten(tmp_path, capsys, out, said):
    for name in ("gap.json", "gap.toml"):
        (tmp_path / name).write_text("kept")
    code = main(["experiment", "--gap", str(tmp_path / out), "--limits", "robot.toml",
                 "--out", str(tmp_path / out)])  # fmt: skip
    assert code == 2
    assert said in capsys.readouterr().err
    assert (tmp_path / out).read_text() == "kept"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [(["--hide", "creep=0.1"], "--repeat"), ([], "none.json")],
)
def test_wrong_options_give_one_sentence(tmp_path, capsys, options, sentence):
    code = main(["experiment", "--gap", str(tmp_path / "none.json"), "--limits", "robot.toml",
                 "--out", str(tmp_path / "motion.toml"), *options])  # fmt: skip
    assert code == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert sentence in told
    assert not (tmp_path / "motion.toml").exists()


def test_trials_that_were_changed_are_refused(late, toy_trials, tmp_path, capsys):
    found, trials = late
    for trial in toy_trials(1):
        write_trial(trial, tmp_path / "trials")
    found.plant.write(tmp_path / "plant.json")
    inputs = DiagnosisInputs(
        str(tmp_path / "plant.json"), "", (str(tmp_path / "trials"),), "0" * 64, dof=1
    )
    document = msgspec.structs.replace(gap_document(found, trials), inputs=inputs)
    write_gap_document(tmp_path / "gap.json", document)
    code = main(["experiment", "--gap", str(tmp_path / "gap.json"), "--limits", "robot.toml",
                 "--out", str(tmp_path / "motion.toml")])  # fmt: skip
    assert code == 2
    assert "are not the trials of this diagnosis" in capsys.readouterr().err
