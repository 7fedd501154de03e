"""Loop in simulated time: phase, missed slots, stale data, approach, records, ends."""

import gc
import math
import re
import tracemalloc

import numpy as np
import pytest

from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.errors import InputError, SafetyTrip
from firmware_py.core.motion import Motion
from firmware_py.core.signals import STAGES
from firmware_py.goals.goal_source import GoalTable
from firmware_py.goals.tip_feedback import Correction
from firmware_py.inference.estimator import Estimate, NoEstimator
from firmware_py.inference.predictor import OnnxPredictor
from firmware_py.loop import ControlLoop
from firmware_py.safety.estimate_trust import TrustState
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import UNRELEASED, Fault, SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.summary import Ended, FeedbackUse
from firmware_py.system.kernel_counters import Counters
from firmware_py.system.timing import Cause
from tests.firmware_py.bus.tampered import LEGACY
from tests.firmware_py.bus.tampered import make as servos_in_memory
from tests.firmware_py.simulated_loop import (
    GOALS,
    PERIOD_NS,
    Bus,
    LeapingClock,
    PluggedBus,
    Steps,
    leaning,
    make,
)


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
def test_slots_that_have_begun_are_skipped_without_a_change_of_phase(duration_ns, missed):
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


def test_the_bus_gets_the_rest_of_its_budget():
    loop, bus, *_ = make(reply_timeout_s=0.008)
    bus.script = {5: PERIOD_NS + 3_000_000}
    loop.run()
    assert set(bus.deadlines) == {8_000_000}
    loop, bus, *_ = make(reply_timeout_s=0.017)
    loop.run()
    assert max(bus.deadlines) <= PERIOD_NS - 2_000_000, "the rest of the tick needs time"


def test_stale_data_degrades_and_three_in_a_row_stop_the_robot():
    loop, bus, *_ = make()
    bus.script = {20: BusStatus.RETRIED, 50: BusStatus.TIMEOUT, 51: BusStatus.CORRUPT}
    bus.script |= dict.fromkeys(range(100, 103), BusStatus.TIMEOUT)
    summary = loop.run()
    rows = summary.records
    running, degraded, stopping = SafetyState.RUNNING, SafetyState.DEGRADED, SafetyState.STOPPING
    assert (rows["state"][20], rows["stale_ticks"][20]) == (running, 0), "a second read is fresh"
    assert rows["state"][49:54].tolist() == [running, degraded, degraded, running, running]
    assert rows["stale_ticks"][50:53].tolist() == [1, 2, 0]
    assert rows["angle_1_rad"][50] == rows["angle_1_rad"][49], "the last good value, not zero"
    assert rows["state"][101:104].tolist() == [degraded, stopping, stopping]
    assert summary.ended is Ended.TRIPPED
    assert "no fresh data for 3 ticks" in summary.reason
    assert summary.bus_faults == {"retried": 1, "timeout": 4, "corrupt": 1}
    assert not bus.driven


class LateBus(Bus):
    """Its measurement 50 is 5 ms late."""

    def read(self, deadline_ns):
        self.late_ns = 5_000_000 if self.reads == 50 else 0
        return super().read(deadline_ns)


def test_the_estimator_gets_the_time_between_samples_not_between_slots():
    estimator = Steps()
    loop, bus, *_ = make(bus=LateBus, estimator=estimator)
    sleep = bus.clock.sleep_until
    bus.clock.sleep_until = lambda time_ns: sleep(time_ns + (3_000_000 if bus.reads == 70 else 0))
    rows = loop.run().records
    assert rows["sample_late_ns"][[49, 50, 51, 69, 70, 71]].tolist() == [
        0, 5_000_000, 0, 0, 3_000_000, 0
    ]  # fmt: skip
    steps_s = np.full(len(rows), 0.017)
    steps_s[[50, 51, 70, 71]] = 0.022, 0.012, 0.020, 0.014
    assert estimator.steps_s == pytest.approx(steps_s)


def test_the_servos_get_their_own_position_as_first_goal_before_the_torque():
    loop, bus, *_ = leaning(0.2)
    events = []
    write, torque = bus.write, bus.torque
    bus.write = lambda goal, deadline: events.append(float(goal[0])) or write(goal, deadline)
    bus.torque = lambda on: events.append(on) or torque(on)
    loop.run()
    assert events[:2] == [0.2, True]


@pytest.mark.parametrize("lean_rad", [-0.6, 1e-6, 0.35, 0.6 - 1e-9])
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


@pytest.mark.parametrize("read", [1, 78])  # the motion begins with the last
def test_slots_missed_during_the_approach_leave_no_jump(read):
    loop, bus, *_ = leaning(0.35)
    bus.script = {read: 2 * PERIOD_NS + 1}
    summary = loop.run()
    goals = summary.records["goal_1_rad"]
    assert (summary.ended, summary.timing.misses) == (Ended.FINISHED, 2)
    assert np.abs(np.diff([0.35, *goals])).max() <= np.abs(np.diff(GOALS[:, 0])).max() * 1.1
    later = (summary.records["tick"] >= 300) & (summary.records["tick"] < len(GOALS))
    assert goals[later] == pytest.approx(GOALS[300:, 0], abs=1e-12)


# --- ends of the loop in simulated time -----------------------------------------------------------


GONE = "no fresh data for 3 ticks (PORT_GONE)"


def test_a_port_that_goes_during_the_approach_lets_the_robot_go_on():
    loop, bus, *_ = leaning(0.35, slots=600, bus=PluggedBus, replug_s=2.0)
    bus.away, bus.script = 5, dict.fromkeys(range(20, 1000), BusStatus.PORT_GONE)
    summary = loop.run()
    assert summary.reason.split("; then ")[:2] == [GONE, "the port was back"]
    assert summary.replugs == 1
    goals = np.array([goal[0] for _, goal in bus.sent])
    assert np.abs(np.diff(goals)).max() < 0.02


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
    assert telemetry.records["tick"].tolist() == list(range(19)), "what led there is logged"


@pytest.mark.parametrize(
    ("off", "error", "words"),
    [
        (BusStatus.TIMEOUT, SafetyTrip, r"torque: cannot be .*not every servo confirmed"),
        (BusStatus.OK, InputError, "torque: cannot be switched on"),
    ],
    ids=["unconfirmed", "confirmed off"],
)
def test_torque_that_cannot_be_switched_on_ends_with_torque_off(off, error, words):
    loop, bus, *_ = make()
    bus.torque = lambda on: bus.calls.append(on) or (BusStatus.TIMEOUT if on else off)
    with pytest.raises(error, match=words):
        loop.run()
    assert bus.calls == ["connect", True, False]


def test_an_error_of_the_program_says_that_the_torque_was_not_confirmed_off():
    loop, bus, predictor, *_ = make()
    predictor.fail_at, torque = 20, bus.torque
    bus.torque = lambda on: torque(on) if on else BusStatus.TIMEOUT
    with pytest.raises(RuntimeError, match="the graph is broken") as raised:
        loop.run()
    assert raised.value.__notes__ == [UNRELEASED]


@pytest.mark.parametrize(
    ("by_s", "reason"), [(3600, "slots missed in a row"), (-3600, "the clock was set back")]
)
def test_a_clock_that_leaps_stops_the_robot_in_its_own_time(by_s, reason):
    clock, estimator = LeapingClock(), Steps()
    clock.at_ns, clock.by_ns = 2_000_000_000, by_s * 1_000_000_000
    loop, bus, *_ = make(estimator=estimator, clock=clock)
    summary = loop.run()
    assert (summary.ended, reason in summary.reason) == (Ended.TRIPPED, True)
    assert not bus.driven
    assert max(estimator.steps_s) < 2.0, "no estimator has to make up for an hour"
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
    assert (summary.ended, summary.faults) == (Ended.TRIPPED, {Fault.DATA}), "there was a fault"
    away = int(re.search(r"for (\d+) ticks the goals were not those", summary.reason)[1])
    goals, ticks = summary.records["goal_1_rad"], summary.records["tick"]
    of_motion = np.isclose(goals, GOALS[np.maximum(ticks, 0) % len(GOALS), 0], rtol=0, atol=1e-12)
    joined = ticks[np.flatnonzero(~of_motion & (ticks < 600))[-1]] + 1
    assert joined - 102 == pytest.approx(away, abs=2)
    assert away * 0.017 < 6.0, "from wherever the limits are, it would take 6 s"
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


# --- faults while the robot stops ----------------------------------------------------------------

STOP_SLOT = 100
HOLD_TICKS = math.ceil(Limits().hold_s / 0.017)


@pytest.mark.parametrize(
    ("status", "alert", "released", "words"),
    [(BusStatus.TIMEOUT, 0, False, UNRELEASED), (BusStatus.OK, 0b1000, True, "motor encoder")],
    ids=["unconfirmed", "alert"],
)
def test_a_servo_that_does_not_confirm_torque_off_is_no_success(status, alert, released, words):
    loop, bus, *_ = make(slots=5)
    torque = bus.torque

    def switched(on):
        bus.alert = 0 if on else alert
        return torque(on) if on else status

    bus.torque = switched
    summary = loop.run()
    assert (summary.ended, summary.released) == (Ended.TRIPPED, released)
    assert words in summary.reason.split("; then ")[1]


@pytest.mark.parametrize(
    ("status", "ends_hold"), [(BusStatus.PORT_GONE, True), (BusStatus.TIMEOUT, False)]
)
def test_data_lost_while_the_robot_stops_is_no_success_and_starts_nothing(status, ends_hold):
    loop, bus, *_ = make(slots=STOP_SLOT, bus=PluggedBus, replug_s=2.0)
    bus.script = dict.fromkeys(range(STOP_SLOT + 2, 1000), status)
    summary = loop.run()
    assert (summary.ended, summary.replugs) == (Ended.TRIPPED, 0)
    assert status.name in summary.reason.split("; then ")[1]
    assert (summary.ticks < STOP_SLOT + HOLD_TICKS) is ends_hold
    assert bus.calls == ["connect", "torque on", "torque off"]


@pytest.mark.parametrize("at", [0, 2, 20, 36])
def test_an_alert_while_the_robot_stops_is_no_success_and_ends_the_hold(at):
    loop, bus, *_ = make(slots=STOP_SLOT)
    bus.script, bus.alert = {STOP_SLOT + at: BusStatus.ALERT}, 0b100000
    summary = loop.run()
    assert summary.ended is Ended.TRIPPED
    assert "overload" in summary.reason.split("; then ")[-1]
    if 2 <= at <= 20:
        assert summary.ticks < STOP_SLOT + HOLD_TICKS
        assert summary.records["alert"][STOP_SLOT + at] == 0b100000


def test_a_robot_that_an_alert_stopped_does_not_start_again_when_its_port_is_back():
    loop, bus, *_ = make(bus=PluggedBus, replug_s=2.0)
    bus.alert = 1
    bus.script = {100: BusStatus.ALERT} | dict.fromkeys(range(101, 1000), BusStatus.PORT_GONE)
    summary = loop.run()
    assert (summary.ended, summary.replugs) == (Ended.TRIPPED, 0)
    assert "input voltage" in summary.reason


# --- records and durations of the loop in simulated time, and net allocation of a tick ------------


def test_telemetry_gets_every_row_and_the_summary_the_last_ones():
    loop, *_, telemetry = make(goals=Motion(dof=2).table_rad(), keep=10)
    summary = loop.run()
    rows = telemetry.records
    assert rows["angle_1_rad"][1:].tolist() == rows["goal_1_rad"][:-1].tolist(), "sample, then goal"
    assert rows["tick"].tolist() == list(range(summary.ticks))
    assert summary.records.tobytes() == rows[-10:].tobytes()


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


@pytest.mark.slow
def test_a_tick_leaves_no_memory_behind(toy_bundle):
    bus, transport, clock = servos_in_memory(
        LEGACY, transport_type=lambda models, clock: LoopbackTransport(models)
    )
    sizes = np.zeros(6, dtype=np.int64)  # beforehand: a list would grow itself

    class Measuring(NoEstimator):
        ticks = 0

        def update(self, angle_rad, current_a, step_s):
            self.ticks += 1
            if self.ticks % 250 == 200:
                gc.collect()
                sizes[self.ticks // 250] = tracemalloc.get_traced_memory()[0]
            return Estimate(0.0, 0.0)

    predictor = OnnxPredictor(toy_bundle / "predictor.onnx", 1)
    loop = ControlLoop(
        bus, Measuring(), predictor, SafetySupervisor(Limits(), 1), GoalTable(GOALS), clock,
        slots=1460, keep=64,
    )  # fmt: skip
    tracemalloc.start()
    try:
        loop.run()
    finally:
        tracemalloc.stop()
    assert transport.get(1, Register.TORQUE_ENABLE) == 0
    assert sizes.all()
    # The interpreter's pools grow now and then; what leaks grows every time.
    assert np.diff(sizes).min() < 50, "less than a fifth of a byte a tick"


def test_lost_data_counts_for_the_host_where_it_delayed_the_thread():
    class Delays(Counters):
        """2 ms of delay in the ticks 19 and 40."""

        calls = 0

        def run_delay_ns(self):
            self.calls += 1
            return 2_000_000 * ((self.calls > 20) + (self.calls > 41))

    loop, bus, *_ = make(counters=Delays())
    bus.script = dict.fromkeys((19, 60), BusStatus.TIMEOUT)
    summary = loop.run()
    stale = summary.records["bus_status"] == BusStatus.TIMEOUT
    delayed = summary.records["preempted_ns"] > 1_000_000
    assert (stale.sum(), delayed.sum(), (stale & delayed).sum()) == (2, 2, 1)
    assert summary.held_up_ticks == 1


class Doubting(Correction):
    """Feedback that is not trusted in some slots, before slot 0 and during the stop too."""

    lost_because = "it is out of range"

    def __init__(self, dof, lost):
        super().__init__(dof)
        self._lost = lost

    def update(self, slot, *_):
        self.trust = self._lost.get(slot, TrustState.TRUSTED)
        return self.value_rad


def test_ticks_in_which_feedback_was_due_and_did_not_act_are_counted():
    lost = {50: TrustState.FADING, 51: TrustState.LOST, -1: TrustState.LOST}
    lost |= dict.fromkeys(range(100, 140), TrustState.LOST)  # of a stop after the motion
    loop, *_ = make(slots=100, correction=Doubting(1, lost))
    used = loop.run().feedback
    assert used == FeedbackUse(ticks=100, lost_ticks=2, reason="it is out of range")
    assert "2 of 100 ticks" in used.note and used.reason in used.note
