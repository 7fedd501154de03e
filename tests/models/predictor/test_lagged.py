"""Lagged regressor: its features, and DI on a motion that it was trained on."""

import numpy as np

from models.predictor.lagged import LaggedRegressor, lagged_features
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
