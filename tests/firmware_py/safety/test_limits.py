"""Limits, each just inside, at and just outside."""

import math

import msgspec
import numpy as np
import pytest

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, Motion
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
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


def stopped_after(supervisor, ticks=3, **measured):
    """States over some ticks with the same measurement."""
    return [check(supervisor, **measured) is SafetyState.STOPPING for _ in range(ticks)]


@both_sides
@around_the_limit
def test_current_at_its_limit(sign, beyond, stops):
    measured = {"current": sign * (4.0 + beyond)}
    assert stopped_after(started(), **measured) == [False, False, stops]


@both_sides
@around_the_limit
def test_following_error_at_its_limit(sign, beyond, stops):
    supervisor = started(msgspec.structs.replace(LIMITS, jump_rad=1.0))
    assert stopped_after(supervisor, angle=sign * (0.25 + beyond)) == [False, False, stops]


@both_sides
@around_the_limit
def test_measured_angle_at_its_limit(sign, beyond, stops):
    supervisor = started(at=sign * 0.5)
    # Goal at 0.5, so 0.75 is at both the following error's and the angle's limit; the angle
    # speaks first.
    supervisor._angle[0] = sign * 0.75
    assert stopped_after(supervisor, angle=sign * (0.75 + beyond)) == [False, False, stops]
    if stops:
        assert "outside its limits" in supervisor.reason


@both_sides
@around_the_limit
def test_encoder_jump_at_its_limit(sign, beyond, stops):
    supervisor = started(msgspec.structs.replace(LIMITS, following_error_rad=1.0))
    step = sign * (0.125 + beyond)
    states = [check(supervisor, angle=k % 2 * step) for k in range(1, 4)]
    assert [s is SafetyState.STOPPING for s in states] == [False, False, stops]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", ["tip_min_m", "tip_max_m"])
@around_the_limit
def test_tip_at_the_wall_of_its_box(axis, side, beyond, stops):
    tip_m = TIP.copy()
    outwards = beyond if side == "tip_max_m" else -beyond
    tip_m[axis] = getattr(LIMITS, side)[axis] + outwards
    assert stopped_after(started(), tip_m=tip_m) == [False, False, stops]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("what", ["tip_m", "di", "angle", "current"])
def test_a_value_that_is_no_number_stops_the_robot(what, bad):
    value = np.array([bad, 0.0, 1.0]) if what == "tip_m" else bad
    assert stopped_after(started(), **{what: value}) == [False, False, True]


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("what", ["angle", "current", "goal", "start"])
def test_the_joint_at_fault_is_named(what, joint):
    supervisor = started(dof=2)
    bad = np.array([9.0 if j == joint else 0.0 for j in (1, 2)])
    still = np.zeros(2)
    if what == "start":
        with pytest.raises(InputError, match=f"joint {joint}"):
            SafetySupervisor(LIMITS, 2, EXACT_S).arm(bad)
        return
    if what == "goal":
        supervisor.admit(bad)
    for _ in range(3):
        supervisor.check(BusStatus.OK, 0, bad if what == "angle" else still,
                         bad if what == "current" else still, TIP, 0.0, 0)  # fmt: skip
    assert f"joint {joint} " in supervisor.reason


def test_a_single_wild_sample_is_forgiven():
    supervisor = started()
    for current in (9.0, 9.0, 0.0, 9.0, 9.0, 0.0):
        assert check(supervisor, current=current) is SafetyState.RUNNING


@both_sides
@around_the_limit
def test_goal_angle_at_its_limit(sign, beyond, stops):
    supervisor = started(at=sign * 0.5)
    first_goal_after(supervisor, sign * (0.5 + beyond))
    assert (supervisor.state is SafetyState.STOPPING) is stops
    assert abs(supervisor.goal_rad[0]) <= 0.5


@both_sides
@around_the_limit
def test_goal_rate_at_its_limit(sign, beyond, stops):
    supervisor = started()
    step = EXACT_S  # 1 rad/s, reached with 64 rad/s2
    first_goal_after(supervisor, sign * step * (1 + beyond))
    assert (supervisor.state is SafetyState.STOPPING) is stops
    assert ("rad/s," in supervisor.reason) is stops


@both_sides
@around_the_limit
def test_goal_acceleration_at_its_limit(sign, beyond, stops):
    limits = msgspec.structs.replace(LIMITS, acceleration_rad_s2=32.0)
    supervisor = started(limits)
    first_goal_after(supervisor, sign * 32.0 * EXACT_S**2 * (1 + beyond))
    assert (supervisor.state is SafetyState.STOPPING) is stops
    assert ("rad/s2" in supervisor.reason) is stops


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_goal_that_is_no_number_is_never_admitted(bad):
    supervisor = started()
    first_goal_after(supervisor, 0.001, bad)
    assert supervisor.state is SafetyState.STOPPING
    assert np.all(np.isfinite(supervisor.goal_rad))


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("kind", [k for k in KINDS if k != "decay"])
def test_the_default_limits_admit_the_motions(kind, dof):
    check_motion(Motion(kind, dof=dof).table_rad(), Limits(), PERIOD_S, kind)


def test_a_motion_beyond_the_limits_is_refused_before_it_starts():
    with pytest.raises(InputError, match=r"motion decay: the goal of joint 1 moves at .* rad/s"):
        check_motion(Motion("decay").table_rad(), Limits(), PERIOD_S, "motion decay")
