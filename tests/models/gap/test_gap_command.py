"""The command refuses what it cannot use, in one sentence."""

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from models.gap.diagnosis import diagnose
from models.trials.trial import TrialSet


def test_missing_trials_are_refused(tmp_path, capsys):
    code = main(["gap", str(tmp_path / "none"), "--plant", "models/plant/nominal.toml",
                 "--out", str(tmp_path / "out")])  # fmt: skip
    assert code == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_given_plant_is_not_replaced_by_the_improved_one(plant, tmp_path, capsys):
    given = tmp_path / "out" / "plant.json"
    plant.write(given)
    before = given.read_bytes()
    code = main(["gap", str(tmp_path / "none"), "--plant", str(given),
                 "--out", str(tmp_path / "new" / ".." / "out")])  # fmt: skip
    assert code == 2
    assert "which is read; name another directory" in capsys.readouterr().err
    assert given.read_bytes() == before


def test_an_unknown_effect_cannot_be_left_out(plant, trials_of):
    with pytest.raises(InputError, match="choose from"):
        diagnose(plant, trials_of(plant, 2, (0.0,), 1), leave_out=["friction"])


def test_one_and_two_joints_are_not_mixed(plant, make_trial):
    trials = TrialSet((make_trial(np.zeros((80, 1))), make_trial(np.zeros((80, 2)))))
    with pytest.raises(InputError, match="one and of two joints"):
        diagnose(plant, trials)


@pytest.mark.parametrize("same", [True, False])
def test_what_is_said_of_the_link_reaches_the_diagnosis(
    same, plant, trials_of, tmp_path, monkeypatch
):
    plant.write(tmp_path / "plant.json")
    trials = trials_of(plant, 2, (0.0,), 1)
    given = []

    def kept(*arguments):
        given.append(arguments[-1])
        raise InputError("the diagnosis", "ends here", "see its settings")

    monkeypatch.setattr("models.commands.gap_workflow.gap.read_usable_trials", lambda *a: trials)
    monkeypatch.setattr("models.gap.report.diagnosis_files.write_diagnosis", kept)
    said = ["--same-link"] if same else []
    main(["gap", "trials", "--plant", str(tmp_path / "plant.json"), "--out", str(tmp_path / "gap"),
          *said])  # fmt: skip
    assert [settings.same_link for settings in given] == [same]
