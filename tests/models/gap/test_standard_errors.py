"""Standard errors of an improved plant: of what a nuisance and an effect move together."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.decision.certainty import read_certainty
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.improved_plant import _standard_errors
from models.gap.residuals.fit_parameters import FitParameter

CLOCK = {"sync_offset_s": 1.0}


@pytest.mark.parametrize(("correlation", "chance_s"), [(-1.0, 0.0), (0.0, 0.01 * 2**0.5)])
def test_the_error_of_a_sum_is_not_that_of_its_parts(correlation, chance_s):
    """What trials know is the sum: its parts may be unknown by as much as their prior."""
    parameters = [
        FitParameter("synchronisation", "nuisance", CLOCK),
        FitParameter("sync_offset_s", "effect", CLOCK, effect="sync_offset"),
    ]
    estimator = SimpleNamespace(
        residuals=SimpleNamespace(fit_parameters=parameters),
        covariance=lambda point, free: 1e-4 * np.array([[1, correlation], [correlation, 1]]),
        mean_square=lambda point: 1.0,
    )
    point = FitPoint(np.array([0.01, 0.02]), 0.0, [])
    full = SimpleNamespace(parameters={"sync_offset_s": None})
    told = _standard_errors(full, estimator, point, np.ones(2, dtype=bool))
    missed_s = 0.02 * read_certainty().error_of_strength("sync_offset")
    assert told == {"sync_offset_s": pytest.approx(np.hypot(chance_s, missed_s))}
