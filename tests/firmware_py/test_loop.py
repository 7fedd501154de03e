"""Loop in simulated time: phase, missed slots, stale data, approach to the motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.errors import InputError
from firmware_py.inference.estimator import NoEstimator
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from firmware_py.summary import Ended
from firmware_py.system.timing import Cause
from tests.firmware_py.simulated_loop import GOALS, PERIOD_NS, Bus, leaning, make


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


@pytest.mark.slow
@settings(deadline=None, max_examples=50)  # a run takes 0.1 s; a busy machine must not fail it
@given(st.dictionaries(st.integers(1, 400), st.integers(0, 3 * PERIOD_NS), max_size=20))
def test_no_two_ticks_share_a_slot_and_none_starts_early(delays):
    loop, bus, *_ = make()
    bus.script = delays
    rows = loop.run().records
    assert np.all(np.diff(rows["tick"]) >= 1)
    assert rows["missed"].sum() == (np.diff(rows["tick"]) - 1).sum()
    assert np.all(rows["lateness_ns"] >= 0)
    assert np.all(np.diff(rows["deadline_ns"]) == np.diff(rows["tick"]) * PERIOD_NS)


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


class Steps(NoEstimator):
    """Notes the time between the samples that it gets."""

    waits_for_fresh = True

    def __init__(self):
        self.steps_s = []

    def update(self, angle_rad, current_a, step_s):
        self.steps_s.append(step_s)
        return super().update(angle_rad, current_a, step_s)


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
