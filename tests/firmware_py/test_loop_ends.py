"""Ends of the loop in simulated time: stops, signals, errors, clocks that leap, ports that go."""

import math
import re

import numpy as np
import pytest

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.errors import InputError, SafetyTrip
from firmware_py.goals.goal_source import GoalTable
from firmware_py.inference.estimator import Estimate, NoEstimator
from firmware_py.loop import ControlLoop
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import UNRELEASED, Fault, SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.summary import Ended
from tests.firmware_py.simulated_loop import (
    GOALS,
    PERIOD_NS,
    Bus,
    LeapingClock,
    PluggedBus,
    StillPredictor,
    leaning,
    make,
)

GONE = "no fresh data for 3 ticks (PORT_GONE)"


def test_a_controlled_stop_holds_the_last_goal_before_the_torque_goes_off():
    loop, bus, *_ = make()
    bus.script = dict.fromkeys(range(100, 1000), BusStatus.TIMEOUT)
    rows = loop.run().records
    goals = rows["goal_1_rad"][102:]
    assert np.all(np.abs(np.diff(goals, 2)) <= 6.0 * 0.017**2 * (1 + 1e-6))
    held = np.flatnonzero(goals == goals[-1])
    assert len(held) * 0.017 >= Limits().hold_s
    assert bus.calls[-1] == "torque off"


@pytest.mark.parametrize("place", ["read", "predict", "estimate"])
@pytest.mark.parametrize("error", [RuntimeError("bug"), KeyboardInterrupt(), SystemExit(1)])
def test_whatever_is_raised_leaves_no_servo_driven(place, error):
    class Failing(NoEstimator):
        calls = 0

        def update(self, angle_rad, current_a, step_s):
            self.calls += 1
            if place == "estimate" and self.calls == 20:
                raise error
            return Estimate(0.0, 0.0)

    loop, bus, predictor, _, telemetry = make(estimator=Failing())
    if place == "read":
        bus.script = {19: error}
    elif place == "predict":
        predictor.fail_at, error = 20, RuntimeError()
    with pytest.raises(type(error)):
        loop.run()
    assert not bus.driven
    assert bus.calls[-1] == "torque off"
    assert telemetry.records["tick"].tolist() == list(range(19)), "what led there is not lost"


def test_torque_that_cannot_be_switched_on_ends_with_torque_off():
    loop, bus, *_ = make()
    bus.torque = lambda on: bus.calls.append(f"torque {on}") or BusStatus.TIMEOUT
    with pytest.raises(SafetyTrip, match=r"torque: cannot be .*not every servo confirmed"):
        loop.run()
    assert bus.calls == ["connect", "torque True", "torque False"]


def test_torque_that_cannot_be_switched_on_but_is_confirmed_off_is_bad_input():
    loop, bus, *_ = make()
    bus.torque = lambda on: BusStatus.TIMEOUT if on else BusStatus.OK
    with pytest.raises(InputError, match="torque: cannot be switched on"):
        loop.run()


def test_an_error_of_the_program_says_that_the_torque_was_not_confirmed_off():
    loop, bus, predictor, *_ = make()
    predictor.fail_at, torque = 20, bus.torque
    bus.torque = lambda on: torque(on) if on else BusStatus.TIMEOUT
    with pytest.raises(RuntimeError, match="the graph is broken") as raised:
        loop.run()
    assert raised.value.__notes__ == [UNRELEASED]


def test_a_port_that_goes_on_the_way_to_the_motion_lets_the_robot_go_on():
    loop, bus, *_ = leaning(0.35, slots=600, bus=PluggedBus, replug_s=2.0)
    bus.away, bus.script = 5, dict.fromkeys(range(20, 1000), BusStatus.PORT_GONE)
    summary = loop.run()
    assert summary.reason.split("; then ")[:2] == [GONE, "the port was back"]
    assert summary.ended is Ended.TRIPPED
    assert summary.replugs == 1
    goals = np.array([goal[0] for _, goal in bus.sent])
    assert np.abs(np.diff(goals)).max() < 0.02


def test_a_hardware_error_stops_the_robot():
    loop, bus, *_ = make()
    bus.script, bus.alert = {30: BusStatus.ALERT}, 0b100000
    summary = loop.run()
    assert summary.ended is Ended.TRIPPED
    assert "overload" in summary.reason
    assert summary.records["alert"][30] == 0b100000


@pytest.mark.parametrize(
    ("by_s", "reason"), [(3600, "slots missed in a row"), (-3600, "the clock was set back")]
)
def test_a_clock_that_leaps_stops_the_robot_in_its_own_time(by_s, reason):
    clock = LeapingClock()
    bus, steps_s = Bus(clock), []

    class Listening(NoEstimator):
        def update(self, angle_rad, current_a, step_s):
            steps_s.append(step_s)
            return Estimate(0.0, 0.0)

    clock.at_ns, clock.by_ns = 2_000_000_000, by_s * 1_000_000_000
    loop = ControlLoop(
        bus, Listening(), StillPredictor(), SafetySupervisor(Limits(), 1), GoalTable(GOALS), clock
    )
    summary = loop.run()
    assert (summary.ended, reason in summary.reason) == (Ended.TRIPPED, True)
    assert not bus.driven
    assert max(steps_s) < 2.0, "no estimator has to make up for an hour"
    assert abs(clock.now_ns() * 1e-9 - by_s) < 5.0, "nor does the loop wait for one"


def test_a_loop_that_is_always_too_slow_stops():
    loop, bus, *_ = make(slots=1000)
    bus.script = dict.fromkeys(range(50, 1000), PERIOD_NS + 1)
    summary = loop.run()
    assert summary.ended is Ended.TRIPPED
    assert "too slow" in summary.reason


def test_a_port_that_comes_back_lets_the_robot_go_on_from_where_it_stands():
    loop, bus, _, supervisor, _ = make(slots=600, bus=PluggedBus, replug_s=2.0)
    bus.away, bus.script = 5, dict.fromkeys(range(100, 1000), BusStatus.PORT_GONE)
    summary = loop.run()
    assert (summary.replugs, supervisor.state) == (1, SafetyState.OFF)
    assert (summary.ended, summary.faults) == (Ended.TRIPPED, {Fault.DATA}), "a fault was seen"
    away = int(re.search(r"for (\d+) ticks the goals were not those", summary.reason)[1])
    goals, ticks = summary.records["goal_1_rad"], summary.records["tick"]
    own = np.isclose(goals, GOALS[np.maximum(ticks, 0) % len(GOALS), 0], rtol=0, atol=1e-12)
    joined = ticks[np.flatnonzero(~own & (ticks < 600))[-1]] + 1
    assert joined - 102 == pytest.approx(away, abs=2)
    assert away * 0.017 < 6.0, "from wherever the limits are, it would take 6 s"
    assert bus.calls == ["connect", "torque on", "connect", "torque on", "torque off"]
    goals = np.array([goal[0] for _, goal in bus.sent])
    assert np.abs(np.diff(goals)).max() < 0.02
    assert summary.records["missed"].max() == 0, "slots without a port are not missed"
    assert np.all(np.diff(summary.records["tick"]) >= 1)


def test_ports_that_go_twice_are_told_once_and_the_last_stop_last():
    loop, bus, *_ = make(slots=600, bus=PluggedBus, replug_s=2.0)
    connect = bus.connect

    def flaky():
        connect()
        start = bus.reads + (100, 150, 200)[bus.connects - 1]
        bus.script = dict.fromkeys(range(start, start + 50), BusStatus.PORT_GONE)
        bus.away = 5 if bus.connects < 3 else 500

    bus.connect = flaky
    summary = loop.run()
    assert summary.replugs == 2
    assert summary.reason.startswith(f"{GONE}; then the port was back; then {GONE}; for ")
    assert (summary.ended, summary.faults) == (Ended.TRIPPED, {Fault.DATA})


@pytest.mark.parametrize(("away", "replug_s"), [(0, 0.0), (50, 2.0)])
def test_a_port_that_stays_away_or_is_not_waited_for_leaves_the_robot_stopped(away, replug_s):
    loop, bus, *_ = make(bus=PluggedBus, replug_s=replug_s)
    bus.away, bus.script = away, dict.fromkeys(range(100, 1000), BusStatus.PORT_GONE)
    summary = loop.run()
    assert (summary.ended, summary.replugs) == (Ended.TRIPPED, 0)
    assert "PORT_GONE" in summary.reason
    assert bus.calls == ["connect", "torque on", "torque off"]


# --- faults while the robot stops ----------------------------------------------------------------

STOP_SLOT = 100
HELD_TICKS = math.ceil(Limits().hold_s / 0.017)


def stopping_with(script, **options):
    """A run that is over at STOP_SLOT; afterwards the reads go as the script says."""
    loop, bus, *_ = make(slots=STOP_SLOT, **options)
    bus.script = {STOP_SLOT + k: event for k, event in script.items()}
    return loop, bus


def test_a_servo_that_does_not_confirm_torque_off_is_no_success():
    loop, bus, *_ = make(slots=5)
    torque = bus.torque
    bus.torque = lambda on: torque(on) if on else BusStatus.TIMEOUT
    summary = loop.run()
    assert (summary.ended, summary.released) == (Ended.TRIPPED, False)
    assert summary.reason.split("; then ")[1:] == [UNRELEASED]


def test_a_port_that_goes_while_the_robot_stops_is_no_success_and_ends_the_hold():
    loop, bus = stopping_with(dict.fromkeys(range(2, 1000), BusStatus.PORT_GONE))
    summary = loop.run()
    assert summary.ended is Ended.TRIPPED
    assert "PORT_GONE" in summary.reason.split("; then ")[1]
    assert summary.ticks < STOP_SLOT + HELD_TICKS
    assert not bus.driven


def test_lost_data_while_the_robot_stops_is_no_success_but_holds_on():
    loop, _ = stopping_with(dict.fromkeys(range(2, 1000), BusStatus.TIMEOUT))
    summary = loop.run()
    assert summary.ended is Ended.TRIPPED
    assert "TIMEOUT" in summary.reason.split("; then ")[1]
    assert summary.ticks > STOP_SLOT + HELD_TICKS


@pytest.mark.parametrize("at", [0, 2, 20, 36])
def test_an_alert_while_the_robot_stops_is_no_success_and_ends_the_hold(at):
    loop, bus = stopping_with({at: BusStatus.ALERT})
    bus.alert = 0b100000
    summary = loop.run()
    assert summary.ended is Ended.TRIPPED
    assert "overload" in summary.reason.split("; then ")[-1]
    if 2 <= at <= 20:
        assert summary.ticks < STOP_SLOT + HELD_TICKS


def test_an_alert_in_the_answer_to_torque_off_is_no_success():
    loop, bus, *_ = make(slots=5)
    torque = bus.torque

    def alarmed(on):
        bus.alert = 0 if on else 0b1000
        return torque(on)

    bus.torque = alarmed
    summary = loop.run()
    assert (summary.ended, summary.released) == (Ended.TRIPPED, True)
    assert "motor encoder" in summary.reason.split("; then ")[1]


def test_a_port_that_goes_while_the_robot_stops_does_not_start_it_again():
    loop, bus = stopping_with(
        dict.fromkeys(range(2, 1000), BusStatus.PORT_GONE), bus=PluggedBus, replug_s=2.0
    )
    assert loop.run().replugs == 0
    assert bus.calls == ["connect", "torque on", "torque off"]


def test_a_robot_that_an_alert_stopped_does_not_start_again_when_its_port_is_back():
    loop, bus, *_ = make(bus=PluggedBus, replug_s=2.0)
    bus.alert = 1
    bus.script = {100: BusStatus.ALERT} | dict.fromkeys(range(101, 1000), BusStatus.PORT_GONE)
    summary = loop.run()
    assert (summary.ended, summary.replugs) == (Ended.TRIPPED, 0)
    assert "input voltage" in summary.reason
