"""Transfer of the plant's own error to other payloads."""

import numpy as np
import pytest

from models.gap.estimation.transfer import transfer_weights, unknown_fraction

REACH_KG = 1.0


@pytest.mark.parametrize("measured_kg", [[1.0], [0.0, 2.0], [0.0, 0.5, 1.0, 1.5, 2.0]])
def test_nothing_is_unknown_where_it_was_measured(measured_kg):
    weights = transfer_weights(measured_kg, measured_kg, REACH_KG)
    assert weights == pytest.approx(np.eye(len(measured_kg)), abs=1e-12)
    unknown = unknown_fraction(measured_kg, measured_kg, REACH_KG)
    assert unknown == pytest.approx(np.zeros_like(weights), abs=1e-12)


def test_more_is_unknown_farther_away_and_never_more_than_all():
    at_kg = np.linspace(1.0, 6.0, 11)
    unknown = np.diag(unknown_fraction(at_kg, [0.0, 1.0], REACH_KG))
    assert np.all(np.diff(unknown) > 0)
    assert unknown[-1] < 1.0
    assert unknown == pytest.approx(1 - np.exp(-2 * (at_kg - 1.0) / REACH_KG))


def test_expected_and_unknown_error_are_those_of_drawn_errors():
    """Errors drawn with the prior correlation: mean and covariance of what the weights miss."""
    at_kg, measured_kg = np.array([0.5, 0.7, 2.5]), np.array([0.0, 1.0, 2.0])
    every = np.concatenate([at_kg, measured_kg])
    prior = np.exp(-np.abs(every[:, None] - every) / REACH_KG)
    drawn = np.linalg.cholesky(prior) @ np.random.default_rng(0).standard_normal((6, 200_000))
    missed = drawn[:3] - transfer_weights(at_kg, measured_kg, REACH_KG) @ drawn[3:]
    assert np.cov(missed) == pytest.approx(unknown_fraction(at_kg, measured_kg, REACH_KG), abs=0.01)
    assert np.corrcoef(missed, drawn[3:])[:3, 3:] == pytest.approx(0.0, abs=0.01)
