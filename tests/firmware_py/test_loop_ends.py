"""Ends of the loop in simulated time: stops, signals, errors, clocks that leap, ports that go."""

import signal

import numpy as np
import pytest

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.errors import InputError
from firmware_py.inference.estimator import Estimate, NoEstimator
from firmware_py.loop import ControlLoop
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
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


def test_a_controlled_stop_holds_the_last_goal_before_the_torque_goes_off():
    loop, bus, *_ = make()
    bus.script = dict.fromkeys(range(100, 1000), BusStatus.PORT_GONE)
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
    with pytest.raises(InputError, match="torque"):
        loop.run()
    assert bus.calls == ["connect", "torque True", "torque False"]


def test_a_port_that_goes_on_the_way_to_the_motion_lets_the_robot_go_on():
    loop, bus, *_ = leaning(0.35, slots=600, bus=PluggedBus, replug_s=2.0)
    bus.away, bus.script = 5, dict.fromkeys(range(20, 1000), BusStatus.PORT_GONE)
    summary = loop.run()
    assert (summary.ended, summary.replugs) == (Ended.FINISHED, 1)
    goals = np.array([goal[0] for _, goal in bus.sent])
    assert np.abs(np.diff(goals)).max() < 0.02


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_brings_a_controlled_stop(number):
    class SignallingBus(Bus):
        def read(self, deadline_ns):
            if self.reads == 100:
                signal.raise_signal(number)
            return super().read(deadline_ns)

    before = signal.getsignal(number)
    loop, bus, *_ = make(bus=SignallingBus)
    summary = loop.run()
    assert (summary.ended, summary.reason) == (Ended.SIGNALLED, number.name)
    assert summary.records["state"][100] == SafetyState.STOPPING
    assert summary.ticks > 100 + Limits().hold_s / 0.017
    assert not bus.driven
    assert signal.getsignal(number) is before


def test_a_hardware_error_stops_the_robot():
    loop, bus, *_ = make()
    bus.script, bus.alert = {30: BusStatus.ALERT}, 0b100000
    summary = loop.run()
    assert summary.ended is Ended.TRIPPED
    assert "overload" in summary.reason
    assert summary.records["alert"][30] == 0b100000


def test_an_impatient_second_signal_does_not_leave_the_torque_on():
    loop, bus, *_ = make(slots=10)
    torque = bus.torque

    def interrupted(on):
        if not on:
            signal.raise_signal(signal.SIGINT)
        return torque(on)

    bus.torque = interrupted
    loop.run()
    assert not bus.driven


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
        bus, Listening(), StillPredictor(), SafetySupervisor(Limits(), 1), GOALS, clock
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
    assert (summary.ended, summary.replugs, supervisor.state) == (
        Ended.FINISHED,
        1,
        SafetyState.OFF,
    )
    assert bus.calls == ["connect", "torque on", "connect", "torque on", "torque off"]
    goals = np.array([goal[0] for _, goal in bus.sent])
    assert np.abs(np.diff(goals)).max() < 0.02
    assert summary.records["missed"].max() == 0, "slots without a port are not missed"
    assert np.all(np.diff(summary.records["tick"]) >= 1)


@pytest.mark.parametrize(("away", "replug_s"), [(0, 0.0), (50, 2.0)])
def test_a_port_that_stays_away_or_is_not_waited_for_leaves_the_robot_stopped(away, replug_s):
    loop, bus, *_ = make(bus=PluggedBus, replug_s=replug_s)
    bus.away, bus.script = away, dict.fromkeys(range(100, 1000), BusStatus.PORT_GONE)
    summary = loop.run()
    assert (summary.ended, summary.replugs) == (Ended.TRIPPED, 0)
    assert "PORT_GONE" in summary.reason
    assert bus.calls == ["connect", "torque on", "torque off"]


def test_a_servo_that_does_not_confirm_torque_off_is_reported():
    loop, bus, *_ = make(slots=5)
    torque = bus.torque
    bus.torque = lambda on: torque(on) if on else BusStatus.TIMEOUT
    assert not loop.run().released
