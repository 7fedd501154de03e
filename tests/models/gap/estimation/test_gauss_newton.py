"""Derivatives by a part of the fit parameters, and fits of few of them."""

import numpy as np
import pytest

from models.gap.estimation.fitted_floor import noise_floor_for
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.residuals.fit_parameters import all_fit_parameters
from models.gap.residuals.residuals import Residuals


@pytest.fixture(scope="module")
def estimator(two_cycles):
    plant, hidden = two_cycles
    trials = hidden(dead_time_1_s=0.02).trials
    residuals = Residuals(plant, trials, all_fit_parameters(plant, trials, ["dead_time"]))
    return GaussNewton(residuals, noise_floor_for(residuals))


def test_derivatives_by_a_part_are_the_columns_of_all_of_them(estimator):
    values = np.zeros(len(estimator.low))
    whole = estimator.linearise(estimator.at(values))
    wanted = np.arange(len(values)) % 3 == 0
    part = estimator.linearise(estimator.at(values), wanted)
    assert part.has_derivatives(wanted) and not part.has_derivatives(~wanted)
    for own, every in zip(part.slopes, whole.slopes, strict=True):
        np.testing.assert_allclose(own[:, wanted], every[:, wanted], rtol=0, atol=1e-9)
        assert not own[:, ~wanted].any()
    step, fall = estimator.step(part, wanted)
    np.testing.assert_allclose(step, estimator.step(whole, wanted)[0], rtol=1e-6, atol=1e-12)
    assert fall > 0


def test_more_derivatives_are_computed_where_a_step_needs_them(estimator):
    values = np.zeros(len(estimator.low))
    first = np.arange(len(values)) == 0
    point = estimator.linearise(estimator.at(values), first)
    assert not point.derived[1:].any()
    estimator.step(point, np.ones(len(values), dtype=bool))
    assert point.derived.all()


def test_a_fit_with_nothing_free_ends_where_it_starts(estimator):
    start = estimator.at(np.zeros(len(estimator.low)))
    end = estimator.fit(start, np.zeros(len(estimator.low), dtype=bool))
    assert end.cost == start.cost and not end.values.any()


def test_a_point_gets_its_derivatives_where_a_step_needs_them_and_they_follow_the_step(estimator):
    free = np.arange(len(estimator.low)) < 4
    start = estimator.linearise(estimator.at(np.zeros(len(estimator.low))), free)
    step, _ = estimator.step(start, free)
    end = estimator.line_search(start, step)
    assert not end.slopes and end.has_derivatives(free) and not end.has_derivatives(~free)
    slopes = [slope.copy() for slope in start.slopes]
    start.slopes = []  # what becomes of the start later does not count
    estimator.step(end, free)
    moved = end.values - start.values
    for own, before, a, b in zip(
        end.slopes,
        slopes,
        estimator.whitened(start.rows),
        estimator.whitened(end.rows),
        strict=True,
    ):
        np.testing.assert_allclose(own @ moved, (a - b).ravel(), rtol=0, atol=1e-8)
        assert np.abs(before @ moved - (a - b).ravel()).max() > 1e-3
