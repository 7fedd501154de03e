"""Strengths to which no step leads, tried from the present fit and from the plant as given."""

import numpy as np
import pytest

from models.gap.estimation.fitted_floor import noise_floor_for
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.residuals.fit_parameters import all_fit_parameters
from models.gap.residuals.residuals import Residuals
from models.gap.search.far_strengths import strengths_far_from_zero

DEAD_TIME_S = 0.06
LAG_S = 0.03


@pytest.fixture(scope="module")
def search_of(plant, hidden):
    """Function (effect, hidden parameters) -> far strengths of it, the present fit, its own."""

    def run(effect, cost=np.inf, from_given=True, **parameters):
        trials = hidden(**parameters).trials
        residuals = Residuals(plant, trials, all_fit_parameters(plant, trials, [effect]))
        estimator = GaussNewton(residuals, noise_floor_for(residuals))
        here = estimator.linearise(estimator.at(np.zeros(len(estimator.low))))
        own = np.array([q.effect == effect for q in residuals.fit_parameters])
        starts = [here, here] if from_given else [here]
        free = np.ones(len(own), dtype=bool)
        found = strengths_far_from_zero(estimator, starts, cost, effect, own, free, False)
        return found, here, own

    return run


def test_the_fit_from_a_far_strength_finds_the_hidden_one(search_of):
    (_, found), here, own = search_of("dead_time", dead_time_1_s=DEAD_TIME_S)
    assert found.cost < here.cost / 100
    assert found.values[own][0] == pytest.approx(DEAD_TIME_S, rel=0.1)


def test_nothing_is_fitted_where_no_strength_promises_less(search_of):
    (point,), here, own = search_of("dead_time", cost=0.0, dead_time_1_s=DEAD_TIME_S)
    assert np.array_equal(point.values[~own], here.values[~own])


def test_a_far_strength_of_the_present_fit_is_tried_beside_earlier_names_too(search_of):
    """A low-pass takes the saw-tooth off the current at any strength: no step leads there."""
    (point,), here, own = search_of("sensor_lag", from_given=False, sensor_lag_1_s=LAG_S)
    assert point.cost < here.cost
    assert point.values[own][0] == pytest.approx(0.02)
