"""Trials of several directories: one set, and no trial that would mislead without a word."""

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.trials.checks.trials import read_usable_trials, refuse_unusable
from models.trials.files import write_trial


@pytest.fixture
def swing(make_trial):
    """Function (factor on the goal, changes) -> a trial of a swinging joint."""

    def make(factor=1.0, **changes):
        angle_rad = 0.5 * np.sin(0.05 * np.arange(200))
        trial = make_trial(angle_rad, rest_samples=0, **changes)
        trial.columns["goal_1_rad"] = factor * angle_rad
        return trial

    return make


def test_names_that_two_directories_hold_are_told_apart(swing, tmp_path):
    for place, factor in (("first", 1.0), ("second", 1.01)):
        write_trial(swing(factor), tmp_path / place)
    trials = read_usable_trials([tmp_path / "first", tmp_path / "second"], {})
    first, second = (t.name for t in trials)
    assert first.startswith("first_") and second == first.replace("first", "second")


def test_a_copy_is_no_repetition(swing, tmp_path):
    for place in ("first", "second"):
        write_trial(swing(), tmp_path / place)
    with pytest.raises(InputError, match="is a copy of"):
        read_usable_trials([tmp_path / "first", tmp_path / "second"], {})


@pytest.mark.parametrize(
    ("factor", "amplitude_rad", "refused"),
    [
        (1.0, 0.5, ""),
        (-1.0, 0.5, "correct the sign of angle_1_rad"),
        (0.0, 0.5, "while goal_1_rad stands still"),
        (0.0, 0.0, ""),  # moved by hand
    ],
)
def test_an_angle_that_mirrors_its_goal_or_moves_without_it_is_refused(
    swing, factor, amplitude_rad, refused
):
    trials = [swing(factor, amplitude_rad=amplitude_rad)]
    if not refused:
        refuse_unusable(trials)
        return
    with pytest.raises(InputError, match=refused):
        refuse_unusable(trials)
