"""Strengths to which no step leads, tried from the plant as given."""

import numpy as np
import pytest

from models.gap.diagnosis import all_fit_parameters
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor_fit import noise_floor_for
from models.gap.residuals.residuals import Residuals
from models.gap.search.dead_zone_effects import strengths_far_from_zero

HIDDEN_S = 0.06


@pytest.fixture(scope="module")
def tried(plant, hidden):
    """Function (cost to fall below) -> fits of a dead time from far strengths, the given point."""
    trials = hidden(dead_time_1_s=HIDDEN_S).trials
    residuals = Residuals(plant, trials, all_fit_parameters(plant, trials, ["dead_time"]))
    estimator = GaussNewton(residuals, noise_floor_for(residuals))
    given = estimator.linearise(estimator.at(np.zeros(len(estimator.low))))
    own = np.array([q.effect == "dead_time" for q in residuals.fit_parameters])
    free = np.ones(len(own), dtype=bool)

    def run(cost):
        start = given, [given], cost
        return strengths_far_from_zero(estimator, *start, "dead_time", own, free, False), given, own

    return run


def test_the_fit_from_a_far_strength_finds_the_hidden_one(tried):
    (found,), given, own = tried(np.inf)
    assert found.cost < given.cost / 100
    assert found.values[own][0] == pytest.approx(HIDDEN_S, rel=0.1)


def test_nothing_is_fitted_where_no_strength_promises_less(tried):
    found, _, _ = tried(0.0)
    assert found == []
