"""Repetition of a diagnosis: what it may replace, and what it never touches."""

from dataclasses import replace

import pytest

from firmware_py.errors import InputError
from models.commands.gap_workflow.repetition import WRITTEN, check_repetition, write_own_trial
from models.gap.report.gap_json import DiagnosisInputs
from models.trials.files import write_trial


@pytest.fixture
def trial(toy_trials):
    return toy_trials(1, amplitudes_deg=(30,))[0]


def content_of_directory(directory):
    return {p.name: p.read_bytes() for p in directory.iterdir()}


def check(tmp_path, trials="trials", gap="gap.json", plant="plant.json"):
    inputs = DiagnosisInputs(str(tmp_path / plant), "", (str(tmp_path / trials),), dof=1)
    check_repetition(tmp_path / "m.toml", tmp_path / gap, inputs)


@pytest.mark.parametrize(
    "read", [{"trials": "m/trials"}, {"gap": "m/gap/gap.json"}, {"plant": "m/gap/plant.json"}]
)
def test_what_is_read_is_not_replaced(tmp_path, read):
    check(tmp_path)
    with pytest.raises(InputError, match="which is read; name another file"):
        check(tmp_path, **read)


def test_a_link_to_a_directory_of_trials_is_that_directory(tmp_path):
    (tmp_path / "trials").mkdir()
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "trials").symlink_to(tmp_path / "trials", target_is_directory=True)
    with pytest.raises(InputError, match="which is read"):
        check(tmp_path)


@pytest.mark.parametrize("name", ["notes.toml", "dof1_payload1_trial1_designed_10deg.csv"])
def test_a_trial_of_others_is_refused_before_the_work(tmp_path, trial, name):
    own = tmp_path / "m" / "trials"
    write_own_trial(trial, own)
    check(tmp_path)
    (own / name).write_text("measured")
    with pytest.raises(InputError, match=f"{name}: is not as --repeat wrote it"):
        check(tmp_path)


def test_the_own_trial_is_replaced_and_nothing_else(tmp_path, trial):
    own = tmp_path / "m" / "trials"
    write_own_trial(replace(trial, name="first"), own)
    for name in ("measured.csv", "measured.toml", "notes.txt"):
        (own / name).write_text("kept")
    write_own_trial(replace(trial, name="second"), own)
    found = content_of_directory(own)
    assert set(found) == {
        "second.csv", "second.toml", WRITTEN, "measured.csv", "measured.toml", "notes.txt",
    }  # fmt: skip
    assert found["measured.csv"] == found["measured.toml"] == found["notes.txt"] == b"kept"


def test_the_own_trial_is_one_of_others_once_it_was_changed(tmp_path, trial):
    own = tmp_path / "m" / "trials"
    write_own_trial(trial, own)
    write_trial(replace(trial, columns=trial.columns | {"angle_1_rad": trial.goal_rad[:, 0]}), own)
    with pytest.raises(InputError, match="is not as --repeat wrote it"):
        check(tmp_path)
    before = content_of_directory(own)
    write_own_trial(replace(trial, name="second"), own)
    after = content_of_directory(own)
    assert after[f"{trial.name}.csv"] == before[f"{trial.name}.csv"]
