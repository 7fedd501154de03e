"""Fallback without the observer: rows, folds, observer runs, and the lagged regressor."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.metrics import r2_score

from firmware_py.core.errors import InputError
from models.plant.simulation.runner import CompiledModel
from models.predictor.fallback import (
    LAG_TICKS,
    block_folds,
    collect_samples,
    fit_fallback,
    fit_lagged,
    lagged_features,
)
from models.trials.deformation import deformation_index
from models.trials.trial import TrialSet


def test_lagged_features_look_back_and_repeat_the_first_sample(toy_trials):
    trial = toy_trials(1)[0]
    signals = np.hstack([trial.angle_rad, trial.current_a])
    features = lagged_features(trial).reshape(len(trial), len(LAG_TICKS), 2)
    np.testing.assert_array_equal(features[0], np.repeat(signals[:1], len(LAG_TICKS), axis=0))
    np.testing.assert_array_equal(features[100], signals[[100 - lag for lag in LAG_TICKS]])


def test_lagged_regressor_estimates_di_on_its_training_motion(toy_trials):
    training, held_out = toy_trials(1).split()
    repeated = held_out.where(lambda t: t.meta.trial == 2)
    lagged = fit_lagged(tuple(training))
    true = np.concatenate([deformation_index(t)[t.moving] for t in repeated])
    estimate = np.vstack([lagged.predict(lagged_features(t))[t.moving] for t in repeated])
    assert r2_score(true, estimate) > 0.8


def test_rows_without_any_marker_are_not_used(toy_trials, toy_observer, toy_fallback):
    trial, hidden = toy_trials(1)[0], np.r_[100:110]
    columns = dict(trial.columns)
    for name in columns:
        if name.startswith("m") and name[1:3].isdigit():
            columns[name] = columns[name].copy()
            columns[name][hidden] = np.nan
    blind = TrialSet((replace(trial, columns=columns),))
    samples = collect_samples(blind, CompiledModel(toy_observer(1)), toy_fallback.lagged)
    assert len(samples) == len(trial) - trial.meta.rest_samples - len(hidden)
    assert np.isfinite(samples.features("true")).all()


def test_blocks_leave_out_every_row_once_and_never_train_within_the_gap():
    time_s = np.concatenate([0.017 * np.arange(512), 0.3 + 0.017 * np.arange(490)])
    run = np.repeat([0, 1], [512, 490])
    folds = block_folds(run, time_s)
    assert len(folds) == 5
    assert sorted(np.concatenate([test for _, test in folds])) == list(range(len(run)))
    for train, test in folds:
        for number in (0, 1):
            trained, tested = time_s[train[run[train] == number]], time_s[test[run[test] == number]]
            whole_s, two_samples_s = np.ptp(time_s[run == number]), 0.035
            assert np.ptp(tested) == pytest.approx(whole_s / 5, abs=two_samples_s)
            apart_s = np.abs(trained[:, None] - tested).min(axis=1)
            assert apart_s.min() >= 1.0 - 1e-9


def test_runs_too_short_for_blocks_are_refused(toy_trials, toy_observer):
    training, _ = toy_trials(1).split()
    short = TrialSet(
        tuple(replace(t, columns={name: c[:80] for name, c in t.columns.items()}) for t in training)
    )
    with pytest.raises(InputError, match="too few"):
        fit_fallback(short, CompiledModel(toy_observer(1)))
