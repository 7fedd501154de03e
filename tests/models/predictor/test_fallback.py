"""Fallback without the observer: rows, observer runs, and the lagged regressor."""

from dataclasses import replace

import numpy as np
import pytest

from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names
from models.predictor.fallback import LaggedRegressor, collect_samples, lagged_features
from models.predictor.observed_trials import observe
from models.predictor.validation import r_squared
from models.trials.deformation import deformation_index


def test_lagged_features_look_back_and_hold_before_the_first_sample():
    angle_rad, current_a = np.arange(6.0)[:, None], 10 + np.arange(6.0)[:, None]
    features = lagged_features(angle_rad, current_a, (0, 2))
    np.testing.assert_array_equal(features[0], [0, 10, 0, 10])
    np.testing.assert_array_equal(features[5], [5, 15, 3, 13])


def test_lagged_regressor_tells_di_on_the_motion_it_knows(toy_trials):
    training, held_out = toy_trials(1).split()
    repeated = held_out.where(lambda t: t.meta.trial == 2)
    lagged = LaggedRegressor.fit(tuple(training), [deformation_index(t) for t in training])
    true = np.concatenate([deformation_index(t)[t.moving] for t in repeated])
    estimate = np.concatenate([lagged.estimate(t)[t.moving] for t in repeated])
    assert r_squared(true, estimate) > 0.8


def test_rows_without_any_marker_are_left_out(toy_trials):
    trial = toy_trials(1)[0]
    hidden = np.r_[100:110]
    columns = {
        name: np.where(np.isin(np.arange(len(trial)), hidden), np.nan, column)
        if name.startswith("m") and name[1:3].isdigit()
        else column
        for name, column in trial.columns.items()
    }
    blind = replace(trial, columns=columns)
    samples = collect_samples((blind,), {"true": [deformation_index(blind)]})
    assert len(samples) == len(trial) - trial.meta.rest_samples - len(hidden)
    assert np.isfinite(samples.features("true")).all()


@pytest.mark.parametrize("dof", [1, 2])
def test_observer_over_a_trial_is_the_step_model_step_by_step(toy_trials, toy_observer, dof):
    trial, model = toy_trials(dof)[0], toy_observer(dof)
    u = np.column_stack([trial.columns[name] for name in names(model.inputs)])
    stepped = model.simulate(u, trial.step_s)[1:]
    [run] = observe(CompiledModel(model), [trial])
    for k, name in enumerate(names(model.outputs)):
        np.testing.assert_allclose(run.signals[name], stepped[:, k], rtol=0, atol=1e-12)
