"""Training command: selection of trials, refusals, bundle and summary."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from models.bundle.train import name_tests, of_phases
from models.study.document import read_study
from models.trials.files import write_trial
from models.trials.trial import TrialSet
from tests.models.made_trials import with_conditions


def train(trials, out, *options, dof="1", plant="models/plant/nominal.toml"):
    return main(
        ["train", str(trials), "--dof", dof, "--out", str(out), "--plant", str(plant), *options]
    )


def test_tests_are_named_by_what_they_are(toy_trials):
    training, held_out = toy_trials(1).split()
    multisine = with_conditions(held_out[0], motion="multisine", amplitude_rad=0.35)
    third = with_conditions(training[0], trial=3)
    ahead = with_conditions(
        held_out[0], amplitude_rad=training[0].meta.amplitude_rad, phase_2_rad=0.7854
    )
    named = name_tests(training, (*held_out, multisine, third, ahead))
    assert list(named) == [
        "trial_2", "trial_3", "unseen_20deg", "unseen_multisine_20deg", "unseen_phase_45deg_30deg",
    ]  # fmt: skip


def test_phases_are_chosen_among_2dof_trials_only(toy_trials):
    one, two = toy_trials(1), toy_trials(2)
    ahead = with_conditions(two[0], phase_2_rad=np.pi / 2)
    trials = TrialSet((*one, *two, ahead))
    assert of_phases(trials, [], "DIR").trials == trials.trials
    assert of_phases(trials, [90.0], "DIR").trials == (*one, ahead)
    assert of_phases(trials, [0.0, 90.0], "DIR").trials == trials.trials
    with pytest.raises(InputError, match=r"45 degrees.*--phase-deg 45"):
        of_phases(trials, [0.0, 45.0], "DIR")


def mirrored(trial):
    return trial.columns | {"angle_1_rad": -trial.columns["goal_1_rad"]}


def slower(trial):
    return trial.columns | {"time_s": 2 * trial.columns["time_s"]}


@pytest.mark.parametrize(
    ("dof", "columns", "reason"),
    [
        ("2", lambda trial: trial.columns, "2DOF"),
        ("1", mirrored, "correct the sign of angle_1_rad"),
        ("1", slower, "has a time step of 0.034 s"),
    ],
)
def test_trials_that_do_not_fit_are_refused(toy_trials, tmp_path, capsys, dof, columns, reason):
    first, *_, last = toy_trials(1, amplitudes_deg=(30,))
    write_trial(first, tmp_path)
    write_trial(replace(last, columns=columns(last)), tmp_path)
    assert train(tmp_path, tmp_path / "out", dof=dof) == 2
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize(
    ("out", "reason"),
    [
        ("full", "exists and is not a bundle"),
        ("full/notes.txt/bundle", "lies under the file"),
    ],
)
def test_a_place_for_no_bundle_is_refused_before_the_trials_are_read(
    toy_bundle, tmp_path, capsys, out, reason
):
    shutil.copytree(toy_bundle, tmp_path / "old")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    assert train(tmp_path / "none", tmp_path / out, plant=tmp_path / "old" / "plant.json") == 2
    refusal = capsys.readouterr().err
    assert refusal.count("\n") == 1 and reason in refusal
    assert (tmp_path / "full" / "notes.txt").read_text() == "mine"


@pytest.mark.slow
def test_several_pressures_and_one_recording_are_warned_of(toy_trials, tmp_path, capsys):
    size = {"link_length_m": 0.95, "link_width_m": 0.15, "base_offset_m": 0.06}
    for trial in toy_trials(1, amplitudes_deg=(30,)):
        trial = with_conditions(trial, **size)
        if trial.meta.payload_kg == 2.0:
            trial = with_conditions(trial, pressure_pa=20e3, recording_sha256="a" * 64)
        write_trial(trial, tmp_path / "trials")
    assert train(tmp_path / "trials", tmp_path / "out", "--study-only", "--json") == 0
    output = capsys.readouterr()
    warning = "pressure_pa differs between the trials: 20000 to 41300 Pa"
    assert f"warning: {warning}" in output.err
    assert warning in " ".join(json.loads(output.out)["warnings"])
    assert "are of one recording; import each recording once; a copy is no test" in output.err
    assert read_study(tmp_path / "out" / "study.json").findings


@pytest.mark.slow
def test_another_link_than_the_papers_is_not_compared_with_its_findings(toy_trials, tmp_path):
    size = {"link_length_m": 0.9, "link_width_m": 0.15, "base_offset_m": 0.06}
    for trial in toy_trials(1, amplitudes_deg=(30,)):
        write_trial(with_conditions(trial, **size), tmp_path / "trials")
    link = tmp_path / "link.toml"
    assert main(["new", str(link), "--length", "0.9", "--largest-payload-kg", "2"]) == 0
    assert train(tmp_path / "trials", tmp_path / "out", "--study", plant=link) == 0
    assert read_study(tmp_path / "out" / "study.json").findings == ()
    assert "eproduced" not in (tmp_path / "out" / "MODEL_CARD.md").read_text(encoding="utf-8")
