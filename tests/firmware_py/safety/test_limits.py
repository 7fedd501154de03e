"""Limits, each just inside, at and just outside; and feedback that is frozen."""

import math

import msgspec
import numpy as np
import pytest

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, Motion
from firmware_py.safety.limits import LEAST_MOTION_RAD, FrozenFeedback, Limits
from firmware_py.safety.states import Fault, SafetyState
from firmware_py.safety.supervisor import SafetySupervisor, check_motion
from tests.firmware_py.safety.supervised import (
    EXACT_S,
    LIMITS,
    TIP,
    check,
    first_goal_after,
    started,
)

PERIOD_S = 0.017
both_sides = pytest.mark.parametrize("sign", [-1, 1])
around_the_limit = pytest.mark.parametrize(
    ("beyond", "stops"), [(-1e-6, False), (0.0, False), (1e-6, True)]
)


def stops_after_three(supervisor, *samples):
    """Whether the robot stops at each of three ticks, the last sample repeated."""
    samples = [*samples, *[samples[-1]] * (3 - len(samples))]
    return [check(supervisor, **sample) is SafetyState.STOPPING for sample in samples]


@both_sides
@around_the_limit
def test_current_at_its_limit(sign, beyond, stops):
    measured = {"current": sign * (4.0 + beyond)}
    assert stops_after_three(started(), measured) == [False, False, stops]


@both_sides
@around_the_limit
def test_following_error_at_its_limit(sign, beyond, stops):
    supervisor = started(msgspec.structs.replace(LIMITS, jump_rad=1.0))
    assert stops_after_three(supervisor, {"angle": sign * (0.25 + beyond)}) == [False, False, stops]


@both_sides
@around_the_limit
def test_measured_angle_at_its_limit(sign, beyond, stops):
    supervisor = started(at=sign * 0.5)
    # The goal is 0.5 rad, so 0.75 rad is at the limits of angle and of following error.
    supervisor._angle[0] = sign * 0.75
    measured = {"angle": sign * (0.75 + beyond)}
    assert stops_after_three(supervisor, measured) == [False, False, stops]
    assert ("outside its limits" in supervisor.reason) is stops


@both_sides
@around_the_limit
def test_encoder_jump_at_its_limit(sign, beyond, stops):
    supervisor = started(msgspec.structs.replace(LIMITS, following_error_rad=1.0))
    there, back = {"angle": sign * (0.125 + beyond)}, {"angle": 0.0}
    assert stops_after_three(supervisor, there, back, there) == [False, False, stops]


def test_a_good_sample_between_outliers_starts_the_count_again():
    supervisor, outlier = started(), {"current": 5.0}
    samples = [outlier, outlier, {}, outlier, outlier, outlier]
    stopped = [check(supervisor, **sample) is SafetyState.STOPPING for sample in samples]
    assert stopped == [False] * 5 + [True]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", ["tip_min_m", "tip_max_m"])
@around_the_limit
def test_tip_at_the_wall_of_its_box(axis, side, beyond, stops):
    tip_m = TIP.copy()
    tip_m[axis] = getattr(LIMITS, side)[axis] + (beyond if side == "tip_max_m" else -beyond)
    assert stops_after_three(started(), {"tip_m": tip_m}) == [False, False, stops]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("what", ["tip_m", "di", "angle", "current"])
def test_a_value_that_is_no_number_stops_the_robot(what, bad):
    value = np.array([bad, 0.0, 1.0]) if what == "tip_m" else bad
    assert stops_after_three(started(), {what: value}) == [False, False, True]


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("what", ["angle", "current", "goal"])
def test_the_joint_at_fault_is_named(what, joint):
    supervisor, still = started(dof=2), np.zeros(2)
    bad = np.array([9.0 if j == joint else 0.0 for j in (1, 2)])
    with pytest.raises(InputError, match=f"joint {joint}"):
        SafetySupervisor(LIMITS, 2, EXACT_S).arm(bad)
    if what == "goal":
        supervisor.admit(bad)
    angle, current = (bad if what == measured else still for measured in ("angle", "current"))
    for _ in range(3):
        supervisor.check(BusStatus.OK, 0, angle, current, TIP, 0.0, 0)
    assert f"joint {joint} " in supervisor.reason


@both_sides
@around_the_limit
def test_goal_angle_at_its_limit(sign, beyond, stops):
    supervisor = started(at=sign * 0.5)
    first_goal_after(supervisor, sign * (0.5 + beyond))
    assert (supervisor.state is SafetyState.STOPPING) is stops
    assert abs(supervisor.goal_rad[0]) <= 0.5


@both_sides
@around_the_limit
@pytest.mark.parametrize(
    ("acceleration_rad_s2", "step_rad", "unit"),
    [(64.0, EXACT_S, "rad/s,"), (32.0, 32.0 * EXACT_S**2, "rad/s2")],
    ids=["rate", "acceleration"],
)
def test_goal_rate_and_acceleration_at_their_limits(
    acceleration_rad_s2, step_rad, unit, sign, beyond, stops
):
    limits = msgspec.structs.replace(LIMITS, acceleration_rad_s2=acceleration_rad_s2)
    supervisor = started(limits)
    first_goal_after(supervisor, sign * step_rad * (1 + beyond))
    assert (supervisor.state is SafetyState.STOPPING) is stops
    assert (unit in supervisor.reason) is stops


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_goal_that_is_no_number_is_never_admitted(bad):
    supervisor = started()
    first_goal_after(supervisor, 0.001, bad)
    assert supervisor.state is SafetyState.STOPPING
    assert np.all(np.isfinite(supervisor.goal_rad))


def test_the_default_limits_admit_every_motion_but_the_jump():
    for kind in KINDS:
        table_rad = Motion(kind, dof=2).table_rad()
        if kind != "decay":
            check_motion(table_rad, Limits(), PERIOD_S, kind)
        else:
            with pytest.raises(InputError, match=r"motion decay: the goal of joint 1 moves at"):
                check_motion(table_rad, Limits(), PERIOD_S, "motion decay")


# --- frozen feedback ------------------------------------------------------------------------------


TICKS = LIMITS.frozen_ticks


def ticks_to_stop(rate_rad_s, current=lambda tick: 0.5):
    """Ticks until a robot stops whose goal moves while its angle stands; None if it goes on."""
    supervisor = started()
    for tick in range(400):
        supervisor.admit(np.array([min(rate_rad_s * tick / 64, 0.2)]))
        if check(supervisor, current=current(tick)) is SafetyState.STOPPING:
            assert supervisor.faults == {Fault.FROZEN}
            return tick
    return None


@pytest.mark.parametrize("rate_rad_s", [0.02, 0.5])
def test_a_repeated_sample_stops_a_moving_robot(rate_rad_s):
    moved = math.ceil(LEAST_MOTION_RAD / (rate_rad_s / 64))
    assert moved + TICKS - 1 <= ticks_to_stop(rate_rad_s) <= moved + TICKS + 2


def test_an_angle_that_stands_while_the_current_changes_is_not_frozen():
    assert ticks_to_stop(0.1, current=lambda tick: 0.5 + 0.01 * (tick % 2)) is None


def test_a_robot_at_rest_is_not_frozen():
    detector = FrozenFeedback(1, TICKS)
    goals = 0.3 + 0.4 * LEAST_MOTION_RAD * np.sin(np.arange(2000))
    assert not any(detector.joint([0.3], [0.0], [g]) is not None for g in goals)


@pytest.mark.parametrize("number", MODELS)
@pytest.mark.parametrize(
    ("period_s", "amplitude_rad"), [(1.0, 0.004), (1.0, 0.5), (60.0, 0.004), (60.0, 0.5)]
)
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
