"""A recorded trial's motion, run again on a rig."""

import numpy as np
import pytest

from firmware_py.core.motion import GLIDE_S, Motion
from models.gap.calibration.trials import recorded_motion
from models.plant.identification.noise_floor import trial_group_key
from models.rig.parameters import read_rig
from models.rig.protocol import TrialCase, run_case


@pytest.fixture(scope="module", params=["multisine", "triangle"])
def trial(request):
    motion = Motion(request.param, amplitude_rad=0.3, period_s=1.7)
    return run_case(read_rig("default"), TrialCase(motion, 0.5, 1, 0))


def test_goals_are_those_of_the_trial_and_go_back_to_the_first_one(trial):
    motion = recorded_motion(trial)
    table = motion.table_rad(rest_samples=trial.meta.rest_samples)
    assert table == pytest.approx(trial.goal_rad)
    end_s = motion.duration_s
    assert motion.goal_rad(-5.0) == pytest.approx(trial.goal_rad[0])
    assert motion.goal_rad(end_s + GLIDE_S) == pytest.approx(trial.goal_rad[0])
    late = motion.goal_rad(np.linspace(end_s - 0.05, end_s + GLIDE_S, 200))[:, 0]
    assert np.abs(np.diff(late)).max() < 0.02


def test_trials_that_are_run_again_belong_to_the_same_motion(trial):
    again = run_case(read_rig("default"), TrialCase(recorded_motion(trial), 1.0, 1, 0))
    assert trial_group_key(again) == trial_group_key(trial)
    assert again.goal_rad == pytest.approx(trial.goal_rad)
