"""The loop in simulated time: phase, missed slots, faults, ends; and no memory left behind."""

import gc
import signal
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.dynamixel import DynamixelBus, ServoSetup
from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.errors import InputError
from firmware_py.inference.estimator import Estimate, NoEstimator
from firmware_py.inference.predictor import Prediction
from firmware_py.loop import ControlLoop
from firmware_py.motion import Motion
from firmware_py.realtime.clock import SimClock
from firmware_py.realtime.timing import Cause
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.signals import STAGES, tick_dtype
from firmware_py.summary import Ended

PERIOD_NS = 17_000_000
GOALS = Motion().table_rad()


class Bus:
    """A bus in memory whose reads take time and fail as a script says."""

    def __init__(self, clock, dof=1):
        self.dof, self.clock = dof, clock
        self.angle_rad, self.current_a = np.zeros(dof), np.zeros(dof)
        self.alert, self.wait_ns = 0, 0
        self.script, self.reads = {}, 0
        self.driven, self.calls, self.sent, self.deadlines = False, [], [], []
        self._goal = np.zeros(dof)

    def connect(self):
        self.calls.append("connect")

    def read(self, deadline_ns):
        self.deadlines.append(deadline_ns - self.clock.now_ns())
        event = self.script.get(self.reads, 0)
        self.reads += 1
        if isinstance(event, BaseException):
            raise event
        if isinstance(event, BusStatus):
            return event
        self.clock.advance(event)
        self.wait_ns += event
        self.angle_rad[:] = self._goal
        return BusStatus.OK

    def write(self, goal_rad, deadline_ns):
        self.sent.append((self.clock.now_ns(), goal_rad.copy()))
        self._goal[:] = goal_rad
        return BusStatus.OK

    def torque(self, on):
        self.calls.append(f"torque {'on' if on else 'off'}")
        self.driven = on
        return BusStatus.OK

    def close(self):
        self.calls.append("close")


class StillPredictor:
    def __init__(self):
        self.prediction = Prediction(np.array([0.0, 0.0, 1.0]), np.ones(1), np.full(3, 0.01))
        self.fail_at, self.calls = None, 0

    def predict(self, angle_rad, current_a, di):
        self.calls += 1
        if self.calls == self.fail_at:
            raise RuntimeError("the graph is broken")
        return self.prediction


class Sent:
    """Telemetry that keeps what it gets."""

    def __init__(self, dof=1):
        self.dtype, self.parts, self.drops = tick_dtype(dof), [], 0

    def put(self, record):
        self.parts.append(bytes(record))

    @property
    def records(self):
        return np.frombuffer(b"".join(self.parts), self.dtype)


def make(goals=GOALS, *, slots=None, bus=None, estimator=None, keep=4096, **options):
    clock = SimClock(123)
    bus = bus(clock) if bus else Bus(clock, goals.shape[1])
    supervisor = SafetySupervisor(Limits(), goals.shape[1])
    predictor, telemetry = StillPredictor(), Sent(goals.shape[1])
    loop = ControlLoop(
        bus, estimator or NoEstimator(), predictor, supervisor, goals, clock, slots=slots,
        telemetry=telemetry, keep=keep, **options,
    )  # fmt: skip
    return loop, bus, predictor, supervisor, telemetry


def test_every_slot_runs_at_its_time_and_the_goals_are_those_of_the_motion():
    loop, bus, _, supervisor, _ = make()
    summary = loop.run()
    assert (summary.ended, supervisor.state) == (Ended.FINISHED, SafetyState.OFF)
    running = summary.records[: len(GOALS)]
    assert running["tick"].tolist() == list(range(len(GOALS)))
    assert np.all(np.diff(running["deadline_ns"]) == PERIOD_NS)
    assert running["goal_1_rad"].tolist() == GOALS[:, 0].tolist()
    assert running["time_s"] == pytest.approx(0.017 * np.arange(len(GOALS)), abs=1e-12)
    assert summary.timing.misses == 0
    assert bus.calls == ["connect", "torque on", "torque off"]


def test_a_row_holds_the_sample_and_the_goal_sent_after_it():
    loop, *_ = make()
    rows = loop.run().records
    assert rows["angle_1_rad"][1:].tolist() == rows["goal_1_rad"][:-1].tolist()


def test_the_motion_repeats_for_as_long_as_asked():
    loop, *_ = make(slots=1000)
    rows = loop.run().records
    assert rows["goal_1_rad"][512:1000].tolist() == GOALS[:488, 0].tolist()
    assert rows["state"][:1000].tolist() == [SafetyState.RUNNING] * 1000
    assert rows["state"][1000] == SafetyState.STOPPING


@pytest.mark.parametrize(
    ("duration_ns", "missed"),
    [(PERIOD_NS - 1, 0), (PERIOD_NS, 0), (PERIOD_NS + 1, 1), (2 * PERIOD_NS, 1),
     (2 * PERIOD_NS + 1, 2)],
)  # fmt: skip
def test_slots_that_have_begun_are_skipped_and_phase_is_kept(duration_ns, missed):
    loop, bus, *_ = make()
    bus.script = {100: duration_ns}
    summary = loop.run()
    ticks = summary.records["tick"]
    assert ticks[100] == 100
    assert ticks[101] == 101 + missed
    assert summary.records["missed"][101] == missed
    start_ns = summary.records["deadline_ns"][0]
    assert np.all(summary.records["deadline_ns"] == start_ns + ticks * PERIOD_NS)
    assert np.all(summary.records["lateness_ns"][101:] == 0)
    assert (summary.timing.misses, summary.timing.longest_run) == (missed, missed)
    assert summary.timing.causes[Cause.BUS_WAIT] == missed
    assert summary.ended is Ended.FINISHED


@given(st.dictionaries(st.integers(1, 400), st.integers(0, 3 * PERIOD_NS), max_size=20))
def test_no_two_ticks_share_a_slot_and_none_starts_early(delays):
    loop, bus, *_ = make()
    bus.script = delays
    rows = loop.run().records
    assert np.all(np.diff(rows["tick"]) >= 1)
    assert rows["missed"].sum() == (np.diff(rows["tick"]) - 1).sum()
    assert np.all(rows["lateness_ns"] >= 0)
    assert np.all(np.diff(rows["deadline_ns"]) == np.diff(rows["tick"]) * PERIOD_NS)


def test_a_stall_leaves_no_jump_in_the_goals():
    loop, bus, *_ = make()
    bus.script = {100: 2 * PERIOD_NS + 1}
    rows = loop.run().records
    steps = np.abs(np.diff(rows["goal_1_rad"]))
    assert steps.max() <= np.abs(np.diff(GOALS[:, 0])).max() * 1.1


def test_the_bus_gets_what_is_left_of_its_budget():
    loop, bus, *_ = make(reply_timeout_s=0.008)
    bus.script = {5: PERIOD_NS + 3_000_000}
    loop.run()
    assert set(bus.deadlines) == {8_000_000}
    loop, bus, *_ = make(reply_timeout_s=0.017)
    loop.run()
    assert max(bus.deadlines) <= PERIOD_NS - 2_000_000, "time is left to the rest of the tick"


def test_stale_data_degrades_and_three_in_a_row_stop_the_robot():
    loop, bus, *_ = make()
    bus.script = {50: BusStatus.TIMEOUT, 51: BusStatus.CORRUPT} | dict.fromkeys(
        range(100, 103), BusStatus.TIMEOUT
    )
    summary = loop.run()
    rows = summary.records
    assert rows["state"][49:54].tolist() == [
        SafetyState.RUNNING, SafetyState.DEGRADED, SafetyState.DEGRADED, SafetyState.RUNNING,
        SafetyState.RUNNING,
    ]  # fmt: skip
    assert rows["stale_ticks"][50:53].tolist() == [1, 2, 0]
    assert rows["angle_1_rad"][50] == rows["angle_1_rad"][49], "the last good value, not zero"
    assert rows["state"][101:104].tolist() == [
        SafetyState.DEGRADED,
        SafetyState.STOPPING,
        SafetyState.STOPPING,
    ]
    assert summary.ended is Ended.TRIPPED
    assert "no fresh data for 3 ticks" in summary.reason
    assert summary.bus_faults == {"timeout": 4, "corrupt": 1}
    assert not bus.driven


def test_data_of_a_second_read_is_fresh_and_counted():
    loop, bus, *_ = make()
    bus.script = dict.fromkeys(range(50, 60), BusStatus.RETRIED)
    summary = loop.run()
    rows = summary.records
    assert summary.ended is Ended.FINISHED
    assert np.all(rows["state"][50:60] == SafetyState.RUNNING)
    assert np.all(rows["stale_ticks"] == 0)
    assert summary.bus_faults == {"retried": 10}


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


def leaning(angle_rad, **options):
    """A loop whose arm leans at the start."""
    loop, bus, *rest = make(**options)
    bus.angle_rad[:] = bus._goal[:] = angle_rad
    return loop, bus, *rest


def test_the_servos_get_their_own_position_as_first_goal_before_the_torque():
    loop, bus, *_ = leaning(0.2)
    events = []
    write, torque = bus.write, bus.torque
    bus.write = lambda goal, deadline: events.append(float(goal[0])) or write(goal, deadline)
    bus.torque = lambda on: events.append(on) or torque(on)
    loop.run()
    assert events[:2] == [0.2, True]


@pytest.mark.parametrize("lean_rad", [-0.6, -0.6 + 1e-9, -0.35, 1e-6, 0.35, 0.6 - 1e-9, 0.6])
def test_an_arm_that_leans_goes_to_the_motion_before_it_begins(lean_rad):
    loop, *_ = leaning(lean_rad)
    summary = loop.run()
    rows = summary.records
    assert (summary.ended, summary.timing.misses) == (Ended.FINISHED, 0)
    before = rows["tick"] < 0
    assert rows["tick"].tolist() == list(range(-before.sum(), len(rows) - before.sum()))
    assert rows["time_s"][before.sum()] == 0.0, "the motion's time begins with the motion"
    assert rows["goal_1_rad"][~before][: len(GOALS)].tolist() == GOALS[:, 0].tolist()
    way = np.diff([lean_rad, *rows["goal_1_rad"][before]]) / 0.017
    assert 0 < np.abs(way).max() <= 0.25 * Limits().rate_rad_s
    assert np.abs(np.diff(way)).max() / 0.017 <= 0.25 * Limits().acceleration_rad_s2


@pytest.mark.parametrize("lean_rad", [-0.6 - 1e-9, 0.6 + 1e-9])
def test_an_arm_that_leans_too_far_is_refused_before_the_torque_is_on(lean_rad):
    loop, bus, *_ = leaning(lean_rad)
    with pytest.raises(InputError, match=r"outside -0\.6 to 0\.6 rad; move it by hand"):
        loop.run()
    assert bus.calls == ["connect"]


@pytest.mark.parametrize("read", [1, 30, 77, 78])  # the motion begins with the last
def test_slots_missed_on_the_way_to_the_motion_leave_no_jump(read):
    loop, bus, *_ = leaning(0.35)
    bus.script = {read: 2 * PERIOD_NS + 1}
    summary = loop.run()
    goals = summary.records["goal_1_rad"]
    assert (summary.ended, summary.timing.misses) == (Ended.FINISHED, 2)
    assert summary.records["tick"][0] == -78
    assert np.abs(np.diff([0.35, *goals])).max() <= np.abs(np.diff(GOALS[:, 0])).max() * 1.1
    later = (summary.records["tick"] >= 300) & (summary.records["tick"] < len(GOALS))
    assert goals[later] == pytest.approx(GOALS[300:, 0], abs=1e-12)


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


def test_the_estimator_is_told_how_much_time_has_passed():
    class Listening(NoEstimator):
        steps_s, resets = (), 0

        def reset(self):
            self.resets += 1

        def update(self, angle_rad, current_a, step_s):
            self.steps_s = (*self.steps_s, step_s)
            return Estimate(0.0, 0.0)

    estimator = Listening()
    loop, bus, *_ = make(estimator=estimator)
    bus.script = {10: PERIOD_NS + 1}
    loop.run()
    assert estimator.resets == 1
    assert estimator.steps_s[9:13] == pytest.approx([0.017, 0.017, 0.034, 0.017])


def test_telemetry_gets_every_record_whole_and_in_order():
    loop, _, _, _, telemetry = make(goals=Motion(dof=2).table_rad())
    summary = loop.run()
    assert telemetry.records.tobytes() == summary.records.tobytes()


def test_the_summary_keeps_the_last_ticks():
    loop, *_ = make(keep=10)
    summary = loop.run()
    assert len(summary.records) == 10
    assert summary.records["tick"].tolist() == list(range(summary.ticks - 10, summary.ticks))


def test_the_stages_add_up_to_the_tick():
    class SlowEstimator(NoEstimator):
        def update(self, angle_rad, current_a, step_s):
            clock.advance(2_000)
            return Estimate(0.0, 0.0)

    loop, bus, *_ = make(estimator=SlowEstimator())
    clock = bus.clock
    bus.script = dict.fromkeys(range(600), 1_000_000)
    rows = loop.run().records
    assert np.all(rows["read_ns"] == 1_000_000)
    assert np.all(rows["bus_wait_ns"] == 1_000_000)
    assert np.all(rows["estimate_ns"] == 2_000)
    assert np.all(sum(rows[f"{stage}_ns"] for stage in STAGES[1:]) == rows["busy_ns"])


def test_goals_of_another_number_of_joints_are_refused():
    with pytest.raises(InputError, match="1 joints"):
        make(goals=np.zeros((10, 2)), bus=lambda clock: Bus(clock, 1))


def test_the_same_run_twice_is_the_same_to_the_bit():
    def rows():
        loop, bus, *_ = make()
        bus.script = {7: BusStatus.CORRUPT, 50: PERIOD_NS + 5}
        return loop.run().records.tobytes()

    assert rows() == rows()


def test_a_tick_leaves_no_memory_behind():
    clock = SimClock()
    models = {1: MODELS[54024], 2: MODELS[54024]}
    transport = LoopbackTransport(models)
    setups = [ServoSetup(id_, model, -0.6, 0.6) for id_, model in models.items()]
    bus = DynamixelBus(transport, setups, clock, period_s=0.017)
    sizes = []

    class Measuring(NoEstimator):
        ticks = 0

        def update(self, angle_rad, current_a, step_s):
            self.ticks += 1
            if self.ticks % 500 == 200:
                gc.collect()
                sizes.append(tracemalloc.get_traced_memory()[0])
            return Estimate(0.0, 0.0)

    goals = Motion(dof=2).table_rad()
    loop = ControlLoop(
        bus, Measuring(), StillPredictor(), SafetySupervisor(Limits(), 2), goals, clock,
        slots=2750, keep=64,
    )  # fmt: skip
    tracemalloc.start()
    try:
        loop.run()
    finally:
        tracemalloc.stop()
    assert transport.get(1, Register.TORQUE_ENABLE) == 0
    assert len(sizes) == 6
    # The interpreter's pools grow now and then; what leaks grows every time.
    assert np.diff(sizes).min() < 100, "less than a fifth of a byte a tick"


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


# --- clocks that leap, a loop that is too slow, a port that comes back ---------------------------


class LeapingClock(SimClock):
    """Leaps once when a time is reached."""

    at_ns, by_ns = 0, 0

    def now_ns(self):
        if self.by_ns and self._now_ns >= self.at_ns:
            self._now_ns, self.by_ns = self._now_ns + self.by_ns, 0
        return super().now_ns()


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


class PluggedBus(Bus):
    """Its port is away for some attempts to open it."""

    away, connects = 0, 0

    def reopen(self):
        self.away -= 1
        return self.away < 0

    def connect(self):
        super().connect()
        self.connects += 1
        self.angle_rad[:] = self._goal  # it measures
        self.script = {} if self.connects > 1 else self.script


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
