"""A changed position gain and a late goal in the effect search: both let the joint lag behind."""

import pytest

from models.gap.diagnosis import diagnose
from models.gap.residuals.fit_parameters import candidate_effects

pytestmark = pytest.mark.slow

CONSIDERED = ("dead_time", "position_gain_change", "sync_offset", "viscous_friction")


@pytest.mark.parametrize(
    ("effect", "parameter", "strength"),
    [
        ("position_gain_change", "position_gain_change_1", -0.2),
        ("position_gain_change", "position_gain_change_1", 0.25),
        ("dead_time", "dead_time_1_s", 0.02),
    ],
)
def test_a_lower_gain_and_a_late_goal_are_told_apart(plant, hidden, effect, parameter, strength):
    others = [e for e in candidate_effects(plant) if e not in CONSIDERED]
    found = diagnose(plant, hidden(**{parameter: strength}), leave_out=others)
    assert found.named == (effect,) and found.verdict == "closed"
    value = found.improved.parameters[parameter]
    assert value.error is not None
    assert abs(value.value - strength) < 3 * value.error + 0.03 * abs(strength)
