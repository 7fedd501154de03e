"""Trials of a motion that were started by hand: their rows are the same times of the motion."""

import numpy as np
import pytest

from firmware_py.motion import Motion
from models.plant.identification.noise_floor import aligned
from models.trials.trial import TrialSet

MOTION = Motion("sinusoid", period_s=2.0)
STEP_S = 0.017


@pytest.fixture
def recorded(make_trial):
    def recorded(rest, end=0, counted=None, name="take"):
        rows = np.arange(rest + round(MOTION.duration_s / STEP_S) + end) - rest
        return make_trial(
            MOTION.goal_rad(rows * STEP_S), name=name, motion="sinusoid", period_s=2.0,
            amplitude_rad=MOTION.amplitude_rad, rest_samples=rest if counted is None else counted,
        )  # fmt: skip

    return recorded


def test_rests_and_ends_of_a_motion_become_equal(recorded):
    trials = aligned(TrialSet((recorded(40, 9), recorded(25, 12), recorded(61, 3, counted=60))))
    assert {t.meta.rest_samples for t in trials} == {25}
    first = trials[0].goal_rad
    assert all(np.array_equal(t.goal_rad, first) for t in trials)
    assert len(first) == 25 + round(MOTION.duration_s / STEP_S) + 3


def test_equal_trials_stay_as_they_are(recorded):
    trials = TrialSet((recorded(40, name="a"), recorded(40, name="b")))
    for before, after in zip(trials, aligned(trials), strict=True):
        assert after.meta == before.meta
        assert all(np.array_equal(after.columns[n], before.columns[n]) for n in before.columns)


def test_a_trial_that_was_broken_off_does_not_shorten_the_others(recorded):
    whole, broken_off = recorded(40), recorded(30, -100)
    kept, short = aligned(TrialSet((whole, broken_off)))
    assert len(kept) == len(whole) - 10 and len(short) == len(broken_off)
