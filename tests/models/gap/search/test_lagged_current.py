"""A lagged current in the effect search: named before the friction that it resembles."""

import pytest

from models.gap.diagnosis import diagnose
from models.gap.residuals.fit_parameters import candidate_effects

pytestmark = pytest.mark.slow

CONSIDERED = ("sensor_lag", "viscous_friction", "dead_time")


def test_a_lagged_current_is_named_and_not_the_friction_that_it_resembles(plant, hidden):
    """A lag takes the saw-tooth of the current's jumps away, which friction changes too."""
    lag_s = 0.02
    others = [e for e in candidate_effects(plant) if e not in CONSIDERED]
    found = diagnose(plant, hidden(sensor_lag_1_s=lag_s), leave_out=others)
    assert found.named[:1] == ("sensor_lag",)
    value = found.improved.parameters["sensor_lag_1_s"]
    assert value.error is not None and abs(value.value - lag_s) < 3 * value.error + 1e-3
