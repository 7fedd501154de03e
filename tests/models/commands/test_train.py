"""Training command: selection of trials, refusals, bundle and summary."""

import json
import shutil
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.errors import InputError
from models.commands.train import name_tests, of_phases, refuse_fitted, refuse_mixed_steps
from models.plant.document import FittedTrial, Provenance
from models.trials.files import write_trial
from models.trials.trial import TrialSet


def fitted(name, trial):
    return Provenance(fitted_trials=(FittedTrial(name, trial.sha256(), "rig"),))


def test_tests_are_named_by_what_they_are(toy_trials):
    training, held_out = toy_trials(1).split()

    def changed(original, **changes):
        return replace(original, meta=msgspec.structs.replace(original.meta, **changes))

    multisine = changed(held_out[0], motion="multisine", amplitude_rad=0.35)
    third = changed(training[0], trial=3)
    ahead = changed(held_out[0], amplitude_rad=training[0].meta.amplitude_rad, phase_2_rad=0.7854)
    named = name_tests(training, (*held_out, multisine, third, ahead))
    assert list(named) == [
        "trial_2", "trial_3", "unseen_20deg", "unseen_multisine_20deg", "unseen_phase_45deg_30deg",
    ]  # fmt: skip


def test_phases_are_chosen_among_2dof_trials_only(toy_trials):
    one, two = toy_trials(1), toy_trials(2)
    ahead = replace(two[0], meta=msgspec.structs.replace(two[0].meta, phase_2_rad=np.pi / 2))
    trials = TrialSet((*one, *two, ahead))
    assert of_phases(trials, None, "DIR") is trials
    assert of_phases(trials, [90.0], "DIR").trials == (*one, ahead)
    assert of_phases(trials, [0.0, 90.0], "DIR").trials == trials.trials
    with pytest.raises(InputError, match=r"45 degrees.*--phase-deg 45"):
        of_phases(trials, [0.0, 45.0], "DIR")


def test_an_unseen_trial_that_the_plant_was_fitted_on_is_refused(toy_trials):
    training, held_out = toy_trials(1).split()
    tests = name_tests(training, tuple(held_out))
    seen = tests["unseen_20deg"][0]
    refuse_fitted(fitted("a", training[0]), "plant.json", tests)
    with pytest.raises(InputError, match=seen.name):
        refuse_fitted(fitted("another name", seen), "plant.json", tests)


def test_trials_of_another_time_step_are_refused(toy_trials):
    first, second, *_ = toy_trials(1)
    slower = replace(second, columns=second.columns | {"time_s": 2 * second.columns["time_s"]})
    refuse_mixed_steps((first, second))
    with pytest.raises(InputError, match=r"0\.034 s.*0\.017 s"):
        refuse_mixed_steps((first, slower))


def test_trials_of_other_joints_are_refused(toy_trials, tmp_path, capsys):
    write_trial(toy_trials(1, amplitudes_deg=(30,))[0], tmp_path)
    arguments = ["train", str(tmp_path), "--dof", "2", "--out", str(tmp_path / "out"),
                 "--plant", "models/plant/nominal.toml"]  # fmt: skip
    assert main(arguments) == 2
    assert "2DOF" in capsys.readouterr().err


def test_a_trial_whose_angle_mirrors_its_goal_is_refused(toy_trials, tmp_path, capsys):
    trial = toy_trials(1, amplitudes_deg=(30,))[0]
    mirrored = trial.columns | {"angle_1_rad": -trial.columns["goal_1_rad"]}
    write_trial(replace(trial, columns=mirrored), tmp_path)
    arguments = ["train", str(tmp_path), "--dof", "1", "--out", str(tmp_path / "out"),
                 "--plant", "models/plant/nominal.toml"]  # fmt: skip
    assert main(arguments) == 2
    assert "correct the sign of angle_1_rad" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ("full", "exists and is not a bundle"),
        ("full/notes.txt", "is a file"),
        ("full/notes.txt/bundle", "lies under the file"),
    ],
)
def test_a_place_for_no_bundle_is_refused_before_the_trials_are_read(
    toy_bundle, tmp_path, capsys, out, said
):
    shutil.copytree(toy_bundle, tmp_path / "old")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("kept")
    code = main(["train", str(tmp_path / "none"), "--dof", "1", "--out", str(tmp_path / out),
                 "--plant", str(tmp_path / "old" / "plant.json")])  # fmt: skip
    assert code == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert said in told
    assert (tmp_path / "full" / "notes.txt").read_text() == "kept"


def test_several_pressures_and_one_recording_are_doubted_in_training(toy_trials, tmp_path, capsys):
    for trial in toy_trials(1, amplitudes_deg=(30,)):
        meta = trial.meta
        if meta.payload_kg == 2.0:
            meta = msgspec.structs.replace(meta, pressure_pa=20e3, recording_sha256="a" * 64)
        size = {"link_length_m": 0.95, "link_width_m": 0.15, "base_offset_m": 0.06}
        write_trial(replace(trial, meta=msgspec.structs.replace(meta, **size)), tmp_path / "trials")
    arguments = ["train", str(tmp_path / "trials"), "--dof", "1", "--out", str(tmp_path / "out")]
    arguments += ["--study-only", "--json", "--plant", "models/plant/nominal.toml"]
    assert main(arguments) == 0
    output = capsys.readouterr()
    told = "warning: pressure_pa differs between the trials: 20000 to 41300 Pa"
    assert told in output.err
    assert told.removeprefix("warning: ") in " ".join(json.loads(output.out)["warnings"])
    assert "are of one recording; import each recording once; a copy is no test" in output.err
