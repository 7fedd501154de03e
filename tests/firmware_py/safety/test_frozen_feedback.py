"""Frozen feedback: old values stop a moving robot, a live servo never does."""

import math

import numpy as np
import pytest

from firmware_py.bus.servo_models import MODELS
from firmware_py.safety.limits import LEAST_MOTION_RAD, FrozenFeedback
from firmware_py.safety.states import Fault, SafetyState
from tests.firmware_py.safety.supervised import LIMITS, check, started

PERIOD_S = 0.017
TICKS = LIMITS.frozen_ticks


def ticks_to_stop(rate_rad_s, angle=lambda goal: 0.0, current=lambda tick: 0.5):
    """Ticks until a robot stops whose goal moves at a constant rate; None if it goes on."""
    supervisor = started()
    for tick in range(400):
        goal = min(rate_rad_s * tick / 64, 0.2)
        supervisor.admit(np.array([goal]))
        if check(supervisor, angle=angle(goal), current=current(tick)) is SafetyState.STOPPING:
            assert supervisor.faults == {Fault.FROZEN}
            return tick
    return None


@pytest.mark.parametrize("rate_rad_s", [0.02, 0.1, 0.5])
def test_a_repeated_sample_stops_a_moving_robot(rate_rad_s):
    moved = math.ceil(LEAST_MOTION_RAD / (rate_rad_s / 64))
    assert moved + TICKS - 1 <= ticks_to_stop(rate_rad_s) <= moved + TICKS + 2


def test_an_angle_that_stands_while_the_current_changes_is_no_frozen_feedback():
    assert ticks_to_stop(0.1, current=lambda tick: 0.5 + 0.01 * (tick % 2)) is None


@pytest.mark.parametrize("angle_rad", [0.0, 0.3])
def test_a_robot_at_rest_is_never_taken_for_frozen(angle_rad):
    detector = FrozenFeedback(1, TICKS)
    wobble_rad = 0.4 * LEAST_MOTION_RAD
    goals = angle_rad + wobble_rad * np.sin(np.arange(2000))
    assert not any(detector.joint([angle_rad], [0.0], [g]) is not None for g in goals)


@pytest.mark.parametrize("number", MODELS)
@pytest.mark.parametrize("period_s", [1.0, 4.352, 60.0])
@pytest.mark.parametrize("amplitude_rad", [0.004, 0.02, 0.5])
@pytest.mark.parametrize("sticks_rad", [0.0, 0.008])
def test_a_live_servo_is_never_taken_for_frozen(number, period_s, amplitude_rad, sticks_rad):
    """The gear holds the angle within `sticks_rad` of its goal, while the loop pushes."""
    model, detector = MODELS[number], FrozenFeedback(1, TICKS)
    angle_rad = 0.0
    for goal in amplitude_rad * np.sin(2 * np.pi * np.arange(0, 2 * period_s, PERIOD_S) / period_s):
        error_rad = goal - angle_rad
        if abs(error_rad) > sticks_rad:
            angle_rad += 0.2 * (error_rad - math.copysign(sticks_rad, error_rad))
        current_a = 40.0 * error_rad
        sample = (
            [round(angle_rad / model.rad_per_pulse) * model.rad_per_pulse],
            [round(current_a / model.current_a_per_lsb) * model.current_a_per_lsb],
        )
        assert detector.joint(*sample, [goal]) is None
