"""Linearised twin: it moves like the twin; its first mode is the link's, not the servo's."""

import control
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from models.plant.linear_twin import LinearTwins, modes, resting_modes
from models.plant.plant import read_plant


@pytest.fixture(scope="module")
def twins():
    return LinearTwins(read_plant().step_model(1), PERIOD_S)


def test_a_linear_twin_moves_like_the_twin(twins):
    """A small step of the goal: the same tip after half a second, at rest, to 1 %."""
    model = read_plant().step_model(1)
    twin = twins.at(1.0, sliding=False)
    at = twin.output_labels.index("tip_x_m")
    small, rows = 1e-5, 30
    x0 = np.asarray(model.initial(np.array([0.0, 1.0]), model.parameter_values())).ravel()
    quiet = model.simulate(np.tile([0.0, 1.0], (rows, 1)), PERIOD_S, x=x0)[:, at]
    moved = model.simulate(np.tile([small, 1.0], (rows, 1)), PERIOD_S, x=x0)[:, at]
    time_s = np.arange(rows + 1) * PERIOD_S
    _, y = control.forced_response(twin, time_s, np.full((1, rows + 1), small))
    assert y[at][-1] == pytest.approx((moved - quiet)[-1], rel=0.01)


@pytest.mark.parametrize(
    ("position_gain", "velocity_gain", "payload_kg"), [(3.0, 3.0, 0.0), (8.0, 6.0, 2.0)]
)
def test_a_slow_servo_that_swings_is_not_taken_for_the_link(
    twins, position_gain, velocity_gain, payload_kg
):
    """The poles of its loop are slower than the link, and damped by less than half."""
    gains = {"position_gain_1_per_s": position_gain, "velocity_gain_1_a_s_rad": velocity_gain}
    slow = LinearTwins(read_plant().with_values(gains).step_model(1), PERIOD_S)
    slowest = next(m for m in modes(slow.at(payload_kg, sliding=False)) if m.damping < 0.5)
    assert slowest.frequency_rad_s < 2.0 and slowest.shares[0] < 0.05
    (mode,), (nominal,) = (resting_modes(t, payload_kg) for t in (slow, twins))
    assert mode.frequency_rad_s == pytest.approx(nominal.frequency_rad_s, rel=0.03)
    assert mode.shares[0] > 0.9


def test_both_planes_of_two_joints_have_the_mode_of_one(twins):
    (one,) = resting_modes(twins, 1.0)
    for mode in resting_modes(LinearTwins(read_plant().step_model(2), PERIOD_S), 1.0):
        assert mode.frequency_rad_s == pytest.approx(one.frequency_rad_s, rel=1e-3)
        assert mode.shares[0] > 0.9


def test_only_the_link_is_linearised():
    plant = read_plant("models/plant/examples/emps_identified.json")
    with pytest.raises(InputError, match="is not the link"):
        plant.linearise()
    with pytest.raises(InputError, match="is 9 kg; give 0 to 3 kg"):
        read_plant().linearise(9.0)
