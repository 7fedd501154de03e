"""Error curves of one motion, carried to trials of other length, step and rest."""

import numpy as np
import pytest

from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.transfer import transferred
from models.plant.identification.noise_floor import (
    TrialGroup,
    coefficient_count,
    cosine_transform,
    trial_group_key,
)

PERIOD_S, ROWS, STEP_S, REST = 2.0, 300, 0.017, 40


def error(time_s):
    """A smooth error that starts with the motion and repeats with it."""
    t = np.maximum(time_s, 0.0)
    return np.sin(2 * np.pi * t / PERIOD_S) + 0.3 * (1 - np.cos(6 * np.pi * t / PERIOD_S))


@pytest.fixture
def trial_of(make_trial):
    def make(rows=ROWS, step_s=STEP_S, rest=REST, periodic=True):
        time_s = step_s * (np.arange(rows) - rest)
        angle = 0.5 * np.sin(2 * np.pi * np.maximum(time_s, 0) / PERIOD_S)
        if not periodic:
            angle = np.where(time_s > 3.5, 0.0, angle)
        return make_trial(angle, step_s=step_s, rest_samples=rest, period_s=PERIOD_S)

    return make


def group_of(trial):
    count = coefficient_count(len(trial), trial.step_s)
    return TrialGroup(trial_group_key(trial), (0,), ("tip_x_m",), count)


def spectrum_of(trial):
    time_s = trial.step_s * (np.arange(len(trial)) - trial.meta.rest_samples)
    return cosine_transform(error(time_s), group_of(trial).coefficients)


@pytest.mark.parametrize(
    "other",
    [{"rows": 270}, {"rest": 25}, {"step_s": 0.011}, {"rows": 520}, {"rows": 290, "rest": 55}],
    ids=str,
)
def test_a_curve_travels_to_other_trials_of_its_motion(trial_of, other):
    """Within the frequencies that count; the transform of a cut curve has more."""
    known, new = trial_of(), trial_of(**other)
    moved = transferred(
        spectrum_of(known)[None], trial_group_key(known), REST * STEP_S, new,
        group_of(new).coefficients,
    )  # fmt: skip
    expected = spectrum_of(new)
    assert np.linalg.norm(moved[0] - expected) < 0.05 * np.linalg.norm(expected)


def test_a_motion_that_goes_on_otherwise_is_unknown(trial_of):
    known, new = trial_of(), trial_of(rows=520, periodic=False)
    assert transferred(
        spectrum_of(known)[None], trial_group_key(known), REST * STEP_S, new, 50
    ) is None  # fmt: skip


def floor_with(curves, rest_s):
    hz = np.array([0.0, 8.0])
    noise, model = {"tip_x_m": np.full(2, 1e-4)}, {"tip_x_m": np.ones(2)}
    return NoiseFloor(hz, noise, model, curves, repeats=2.0, rest_s=rest_s)


def test_the_floor_expects_the_error_of_a_trial_with_fewer_rows(trial_of):
    known, new = trial_of(), trial_of(rows=270)
    key, group = trial_group_key(known), group_of(new)
    floor = floor_with({key: {1.0: {"tip_x_m": spectrum_of(known)}}}, {key: REST * STEP_S})
    assert floor.curves_for(group, [new])[1] == "transferred"
    assert floor.curves_for(group_of(known), [known])[1] == "measured"
    left = floor.mean(group, [new])[0, 0] - spectrum_of(new)
    assert np.linalg.norm(left) < 0.05 * np.linalg.norm(spectrum_of(new))
    blind = floor_with({}, {})
    assert blind.curves_for(group, [new]) == ({}, "unknown")
    assert (floor.whitener(group, [new]) > 1.5 * blind.whitener(group, [new])).all()
