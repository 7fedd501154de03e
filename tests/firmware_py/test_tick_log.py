"""Records and durations of the loop in simulated time, and net allocation of a tick."""

import gc
import tracemalloc

import numpy as np
import pytest

from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.servo_setup import ServoSetup
from firmware_py.core.motion import Motion
from firmware_py.core.signals import STAGES
from firmware_py.goals.goal_source import GoalTable
from firmware_py.goals.tip_feedback import Correction
from firmware_py.inference.estimator import Estimate, NoEstimator
from firmware_py.loop import ControlLoop
from firmware_py.safety.estimate_trust import TrustState
from firmware_py.safety.limits import Limits
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.summary import FeedbackUse
from firmware_py.system.clock import SimClock
from firmware_py.system.kernel_counters import Counters
from tests.firmware_py.simulated_loop import (
    StillPredictor,
    make,
)


def test_a_row_holds_the_sample_and_the_goal_sent_after_it():
    loop, *_ = make()
    rows = loop.run().records
    assert rows["angle_1_rad"][1:].tolist() == rows["goal_1_rad"][:-1].tolist()


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


@pytest.mark.slow
def test_a_tick_leaves_no_memory_behind():
    clock = SimClock()
    models = {1: MODELS[54024], 2: MODELS[54024]}
    transport = LoopbackTransport(models)
    setups = [ServoSetup(id_, model, -0.6, 0.6) for id_, model in models.items()]
    bus = DynamixelBus(transport, setups, clock, period_s=0.017)
    sizes = np.zeros(6, dtype=np.int64)  # beforehand: a list would grow itself

    class Measuring(NoEstimator):
        ticks = 0

        def update(self, angle_rad, current_a, step_s):
            self.ticks += 1
            if self.ticks % 250 == 200:
                gc.collect()
                sizes[self.ticks // 250] = tracemalloc.get_traced_memory()[0]
            return Estimate(0.0, 0.0)

    goals = Motion(dof=2).table_rad()
    loop = ControlLoop(
        bus, Measuring(), StillPredictor(), SafetySupervisor(Limits(), 2), GoalTable(goals), clock,
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


def test_lost_data_is_the_hosts_where_it_held_the_thread_up():
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
