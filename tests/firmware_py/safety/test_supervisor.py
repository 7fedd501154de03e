"""Supervisor: degradation, stops, ends and restarts."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.errors import InputError
from firmware_py.safety.states import TRANSITIONS, UNRELEASED, Fault, SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from tests.firmware_py.safety.supervised import EXACT_S, LIMITS, check, first_goal_after, started


@pytest.mark.parametrize(("ticks", "stops"), [(1, False), (2, False), (3, True)])
def test_stale_data_degrades_and_then_stops(ticks, stops):
    supervisor = started()
    for _ in range(ticks):
        state = check(supervisor, status=BusStatus.TIMEOUT)
    assert state is (SafetyState.STOPPING if stops else SafetyState.DEGRADED)
    assert supervisor.stale_ticks == ticks
    assert ("no fresh data" in supervisor.reason) is stops
    if not stops:
        assert check(supervisor) is SafetyState.RUNNING
        assert supervisor.stale_ticks == 0


def test_missed_slots_count_as_stale_ticks():
    supervisor = started()
    assert check(supervisor, status=BusStatus.CORRUPT) is SafetyState.DEGRADED
    assert check(supervisor, status=BusStatus.CORRUPT, missed=1) is SafetyState.STOPPING


@pytest.mark.parametrize(("missed", "stops"), [(2, False), (3, True)])
def test_a_long_stall_stops_the_robot(missed, stops):
    assert (check(started(), missed=missed) is SafetyState.STOPPING) is stops


def test_a_hardware_error_stops_at_once_and_is_named():
    supervisor = started()
    assert check(supervisor, status=BusStatus.ALERT, alert=0b100) is SafetyState.STOPPING
    supervisor.request_stop("SIGTERM")  # the first reason stands
    assert supervisor.tripped
    assert "overheating" in supervisor.reason and "SIGTERM" not in supervisor.reason


def ticks_to_off(supervisor):
    for ticks in range(1, 200):
        supervisor.admit(np.zeros(1))
        if supervisor.state is SafetyState.OFF:
            return ticks
    raise AssertionError("it never ends")


def stopping(limits=LIMITS):
    supervisor = started(limits)
    supervisor.request_stop("enough")
    return supervisor


@given(st.floats(-0.9, 0.9), st.floats(-0.4, 0.4))
def test_a_controlled_stop_slows_down_holds_and_ends(rate, at):
    supervisor = started(at=at)
    supervisor._velocity[0] = rate
    supervisor.request_stop("enough")
    assert supervisor.state is SafetyState.STOPPING
    positions = [at]
    while supervisor.state is SafetyState.STOPPING:
        positions.append(first_goal_after(supervisor, math.nan))
        assert len(positions) < 200
    rates = np.diff(positions) / EXACT_S
    decelerations = -np.diff(np.abs([rate, *rates])) / EXACT_S
    assert np.all((decelerations >= -1e-9) & (decelerations <= 8.0 + 1e-9))
    still = np.flatnonzero(rates)[-1] if rates.any() else -1
    assert (len(rates) - 1 - still) * EXACT_S == 0.5, "hold_s"
    assert not supervisor.tripped


def test_a_controlled_stop_does_not_leave_the_limits():
    supervisor = started(at=0.49)
    supervisor._velocity[0] = 0.9
    supervisor.request_stop("enough")
    while supervisor.state is SafetyState.STOPPING:
        assert 0.49 <= first_goal_after(supervisor, 0.0) <= 0.5


HOLD_TICKS = 32  # hold_s in periods


def test_without_a_time_to_hold_the_torque_goes_off_at_rest():
    assert ticks_to_off(stopping(msgspec.structs.replace(LIMITS, hold_s=0.0))) == 1


@pytest.mark.parametrize(
    ("measured", "times", "words", "ends_hold"),
    [
        ({"status": BusStatus.ALERT, "alert": 0b100}, 1, "overheating", True),
        ({"status": BusStatus.PORT_GONE}, 3, "no fresh data for 3 ticks (PORT_GONE)", True),
        ({"current": 9.0}, 3, "draws", True),
        ({"status": BusStatus.TIMEOUT}, 3, "no fresh data for 3 ticks (TIMEOUT)", False),
        ({"missed": 3}, 1, "3 slots missed in a row", False),
        ({"missed": 1}, 13, "too slow for its period", False),
    ],
)
def test_a_fault_during_a_stop_is_reported_and_ends_the_hold_where_holding_is_worse(
    measured, times, words, ends_hold
):
    supervisor = stopping()
    for _ in range(times):
        assert (supervisor.reason, supervisor.faults) == ("enough", frozenset())
        check(supervisor, **measured)
    assert supervisor.reason.startswith("enough; then ")
    assert words in supervisor.reason
    assert (supervisor.tripped, bool(supervisor.faults)) == (False, True)
    assert ticks_to_off(supervisor) == (1 if ends_hold else HOLD_TICKS)


def test_a_fault_that_lasts_is_reported_once():
    supervisor = started()
    for _ in range(6):
        check(supervisor, status=BusStatus.TIMEOUT)
    check(supervisor, status=BusStatus.ALERT, alert=1)
    data, alert = supervisor.reason.split("; then ")
    assert "TIMEOUT" in data and "input voltage" in alert


@pytest.mark.parametrize(("alert", "released"), [(0, True), (8, True), (0, False)])
def test_the_answer_to_torque_off_belongs_to_the_reason(alert, released):
    supervisor = stopping()
    ticks_to_off(supervisor)
    supervisor.conclude(alert, released=released)
    assert ("motor encoder" in supervisor.reason) is bool(alert)
    assert (UNRELEASED in supervisor.reason) is not released
    assert bool(supervisor.faults) is (bool(alert) or not released)
    assert not supervisor.tripped


@pytest.mark.parametrize(
    ("at", "refused"), [(0.5, False), (0.5 + 1e-6, True), (-0.6, True), (math.nan, True)]
)
def test_a_robot_outside_its_limits_does_not_start(at, refused):
    supervisor = SafetySupervisor(LIMITS, 1, EXACT_S)
    if refused:
        with pytest.raises(InputError, match="by hand"):
            supervisor.arm(np.array([at]))
    else:
        supervisor.arm(np.array([at]))
    assert (supervisor.state is SafetyState.STARTING) is refused
    assert (supervisor.reason, supervisor.tripped) == ("", False)


@pytest.mark.parametrize("punctual", [0, 2])
def test_a_punctual_tick_makes_up_for_one_missed_slot(punctual):
    supervisor = started()
    for _ in range(punctual + 1):  # the first has nothing to make up for
        check(supervisor)
    for _ in range(12):
        check(supervisor, missed=1)
    assert supervisor.state is SafetyState.RUNNING
    for _ in range(punctual):
        check(supervisor)
    for _ in range(punctual):
        check(supervisor, missed=1)
    assert supervisor.state is SafetyState.RUNNING
    check(supervisor, missed=1)
    assert supervisor.state is SafetyState.STOPPING
    assert "too slow" in supervisor.reason


def restarted(supervisor, at=0.0):
    """The supervisor, started again after its torque went off."""
    ticks_to_off(supervisor)
    supervisor.restart()
    assert (supervisor.state, supervisor.reason) == (SafetyState.STARTING, "")
    assert (supervisor.tripped, supervisor.stale_ticks) == (False, 0)
    supervisor.arm(np.array([at]))
    supervisor.start()
    return supervisor


def stopped_by_port(supervisor):
    for _ in range(3):
        check(supervisor, status=BusStatus.PORT_GONE)
    assert "PORT_GONE" in supervisor.reason
    return supervisor


def test_a_restarted_robot_has_its_whole_allowance_of_missed_slots():
    supervisor = started()
    check(supervisor, missed=2)
    supervisor = restarted(stopped_by_port(supervisor), at=0.3)
    for _ in range(12):
        assert check(supervisor, angle=0.3, missed=1) is SafetyState.RUNNING


def test_the_final_reason_names_what_stopped_the_robot_before_its_restarts():
    supervisor = started()
    for _ in range(2):
        supervisor = restarted(stopped_by_port(supervisor))
        assert supervisor.faults == {Fault.DATA}
    supervisor.request_stop("the motion is over")
    supervisor.conclude(1, released=True)
    assert not supervisor.tripped
    assert supervisor.faults == {Fault.DATA, Fault.ALERT}
    gone, _, over, alert = supervisor.reason.split("; then ")
    assert "PORT_GONE" in gone and over == "the motion is over" and "input voltage" in alert


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_restarted_robot_is_at_rest(sign):
    supervisor = started()
    first_goal_after(supervisor, *(0.5 * EXACT_S * k for k in range(1, 4)))
    supervisor.request_stop("enough")
    supervisor = restarted(supervisor)
    supervisor.rebase(np.zeros(1))
    first_goal_after(supervisor, sign * EXACT_S)  # at the limits of rate and acceleration
    assert supervisor.state is SafetyState.RUNNING


def test_goals_are_those_of_the_motion_but_in_a_blend_and_in_a_stop():
    supervisor = started(at=0.1, desired=0.0)  # blends for 64 ticks
    for _ in range(64):
        assert not supervisor.following
        first_goal_after(supervisor, 0.0)
    assert supervisor.following
    check(supervisor, status=BusStatus.TIMEOUT)
    assert supervisor.state is SafetyState.DEGRADED and supervisor.following
    supervisor.request_stop("enough")
    assert not supervisor.following


def test_the_machine_makes_no_step_that_is_not_drawn():
    steps = {(t.source, t.target) for t in TRANSITIONS}
    assert (SafetyState.STARTING, SafetyState.RUNNING) not in steps
    with pytest.raises(ValueError, match="STARTING does not lead to RUNNING"):
        SafetySupervisor(LIMITS, 1, EXACT_S).start()
    with pytest.raises(ValueError, match="RUNNING does not lead to STARTING"):
        started().restart()
    reached = {SafetyState.STARTING}
    for _ in SafetyState:
        reached |= {t.target for t in TRANSITIONS if t.source in reached}
    assert reached == set(SafetyState)
