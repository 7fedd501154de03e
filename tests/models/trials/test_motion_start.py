"""Start of a motion: the goals of a reference motion tell it, whoever counted the rest."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_py.core.motion import KINDS, Motion
from models.trials.trial import motion_start

STEP_S = 0.017


def goals_rad(motion, rest, end=0):
    rows = np.arange(rest + round(motion.duration_s / STEP_S) + end) - rest
    return motion.goal_rad(rows * STEP_S)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("period_s", "resolution_rad"),
    [(1.0, 0.0), (4.352, 2 * np.pi / 4096), (20.0, 2 * np.pi / 4096)],
)
def test_the_start_is_fitted_to_the_goals(kind, period_s, resolution_rad, make_trial):
    for dof, phase_rad, end in ((1, 0.0, 0), (2, 0.0, 50), (2, np.pi / 2, 0)):
        motion = Motion(kind, dof=dof, period_s=period_s, phase_2_rad=phase_rad)
        goals = goals_rad(motion, 37, end)
        if resolution_rad:
            goals = np.round(goals / resolution_rad) * resolution_rad
        trial = make_trial(
            goals, motion=kind, period_s=period_s, phase_2_rad=phase_rad, rest_samples=30,
            amplitude_rad=motion.amplitude_rad,
        )  # fmt: skip
        assert motion_start(trial) == 37
        turned = {n: -v if n.startswith("goal_") else v for n, v in trial.columns.items()}
        assert motion_start(replace(trial, columns=turned)) == 37


@pytest.mark.parametrize(
    "other", [{"motion": "wave"}, {"period_s": 3.0}, {"amplitude_rad": 0.3}, {"period_s": 1e-9}]
)
def test_of_other_goals_the_stated_rest_is_used(other, make_trial):
    motion = Motion("sinusoid", period_s=2.0)
    conditions = {
        "motion": "sinusoid", "period_s": 2.0, "amplitude_rad": motion.amplitude_rad,
        "rest_samples": 30, **other,
    }  # fmt: skip
    assert motion_start(make_trial(goals_rad(motion, 37), **conditions)) == 30
