"""Replay of a recorded run: today's loop gets the recorded measurements and times.

Bus, clock, estimator and predictor return the recorded values; motion, supervisor, blending and the
loop itself are the code under test. The replay shows whether the same measurements lead to the same
goals, states and end. It does not simulate how the servos would react to other goals.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.errors import DropstitchError, SafetyTrip
from firmware_py.goals.goal_source import GoalTable
from firmware_py.inference.estimator import Estimate
from firmware_py.inference.predictor import NO_SIGNALS, Prediction
from firmware_py.loop import ControlLoop
from firmware_py.safety.states import SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.system.clock import SimClock
from firmware_py.system.service import Service
from hil.faults.cases.case_robot import case_goals
from hil.faults.fault_row import Setup
from hil.faults.recorded.recorded_run import RunTape, TapeFacts

__all__ = ["replay_run"]

Array = NDArray[np.float64]
SAME_RAD = 1e-9
"""Largest difference of goals that counts as rounding; a pulse of the finest servo is 6 µrad."""


class _RunsOnError(DropstitchError):
    """The loop reads a tick after the recorded end."""


class _Playback(Service):
    """Bus, clock, estimator, predictor and service of a recorded run."""

    waits_for_fresh: ClassVar[bool] = False

    def __init__(self, run: RunTape) -> None:
        facts, columns = run.facts, run.columns
        self._facts, self._columns = facts, columns
        self.dof = facts.config.dof
        joints = range(1, self.dof + 1)
        self._angles = np.stack([columns[f"angle_{j}_rad"] for j in joints], axis=1)
        self._currents = np.stack([columns[f"current_{j}_a"] for j in joints], axis=1)
        self._tips = np.stack([columns[f"predicted_tip_{a}_m"] for a in "xyz"], axis=1)
        self.angle_rad: Array = np.zeros(self.dof)
        self.current_a: Array = np.zeros(self.dof)
        self.alert, self.wait_ns, self.late_ns, self.row = 0, 0, 0, 0
        self._connections, self._switches, self._in_tick = 0, 0, False
        self._clock, self._wake_ns = SimClock(), 0
        self._last_tick = self._last_lateness_ns = 0
        self._stopping = columns["state"] >= SafetyState.STOPPING
        self._period_ns = round(facts.config.period_s * 1e9)
        self.loop: ControlLoop
        self.supervisor: SafetySupervisor

    def _at(self, name: str) -> int:
        return int(self._columns[name][self.row])

    def _set_clock(self, time_ns: int) -> None:
        self._clock.advance(time_ns - self._clock.now_ns())

    # --- clock

    def now_ns(self) -> int:
        return self._clock.now_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Wake with the recorded lateness; while the port is missing, at the deadline."""
        if self.supervisor.state is SafetyState.OFF:
            self._clock.sleep_until(deadline_ns)
        elif self.row < self._facts.ticks:
            self._wake_ns = deadline_ns + self._at("lateness_ns")
            self._set_clock(self._wake_ns)

    # --- bus

    def connect(self) -> None:
        """Set the recorded angles of this connection."""
        known = self._facts.connected_rad
        self.angle_rad[:] = known[min(self._connections, len(known) - 1)]
        if self._connections:  # the port came back: continue in the recorded slot
            start_ns = self._wake_ns - self._last_lateness_ns - self._last_tick * self._period_ns
            self._set_clock(start_ns + self._at("tick") * self._period_ns - 1)
        self._connections += 1
        self.alert = 0

    def reopen(self) -> bool:
        """Return whether the port came back in the recorded run."""
        return self.row < self._facts.ticks

    def read(self, deadline_ns: int) -> BusStatus:
        """Return the recorded measurement of this tick."""
        if self.row >= self._facts.ticks:
            raise _RunsOnError("the loop goes on after the recorded end")
        if self._facts.requested and self._stopping[self.row]:
            self.loop.stop(self._facts.requested)
        self._in_tick = True
        self._last_tick, self._last_lateness_ns = self._at("tick"), self._at("lateness_ns")
        self.angle_rad[:], self.current_a[:] = self._angles[self.row], self._currents[self.row]
        self.alert = self._at("read_alert")
        self._clock.advance(self._at("read_ns"))
        return BusStatus(self._at("read_status"))

    def write(self, goal_rad: Array, deadline_ns: int) -> BusStatus:
        """Return the recorded status of the write in this tick."""
        if not self._in_tick:
            return BusStatus.OK
        self._clock.advance(sum(map(self._at, ("command_ns", "check_ns", "write_ns"))))
        return BusStatus(self._at("write_status"))

    def torque(self, on: bool) -> BusStatus:
        """Return the recorded status of this switch of the torque."""
        known = self._facts.torque
        status, self.alert = known[min(self._switches, len(known) - 1)]
        self._switches += 1
        return BusStatus(status)

    def close(self) -> None:
        """Do nothing."""

    # --- estimator and predictor

    def reset(self) -> None:
        """Do nothing: the estimates are recorded."""

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        """Return the recorded DI."""
        self._clock.advance(self._at("estimate_ns"))
        return Estimate(float(self._columns["di"][self.row]), float("nan"))

    def predict(
        self,
        angle_rad: Array,
        current_a: Array,
        di: float,
        signals: Array = NO_SIGNALS,
        age_s: float = 0.0,
    ) -> Prediction:
        """Return the recorded tip."""
        self._clock.advance(self._at("predict_ns"))
        return Prediction(self._tips[self.row].astype(np.float64), np.ones(1), np.zeros(3))

    # --- service

    def alive(self) -> None:
        """End the tick at the recorded time."""
        if self._in_tick:
            self._set_clock(self._wake_ns + self._at("busy_ns"))
            self._in_tick = False
            self.row += 1


def replay_run(run: RunTape) -> str:
    """Run today's loop on the measurements of a recorded run.

    Returns a description of the first difference in goals, states or end; empty if there is none.
    """
    facts, config, played = run.facts, run.facts.config, _Playback(run)
    goals = case_goals(config, Setup(through_pulse=facts.through_pulse), facts.number)
    supervisor = SafetySupervisor(config.limits_in_force, config.dof, config.period_s)
    played.supervisor = supervisor
    played.loop = loop = ControlLoop(
        played, played, played, supervisor, GoalTable(goals), played,
        slots=facts.slots, period_s=config.period_s, reply_timeout_s=config.bus.reply_timeout_s,
        replug_s=config.bus.replug_s, service=played, keep=2 * facts.ticks + 1,
    )  # fmt: skip
    try:
        summary = loop.run()
    except (_RunsOnError, SafetyTrip) as error:
        return str(error)
    return _difference(facts, run, summary.records, summary.ended.value, summary.reason)


def _difference(
    facts: TapeFacts, run: RunTape, records: NDArray[np.void], ended: str, reason: str
) -> str:
    count = min(len(records), facts.ticks)
    for name in ("tick", "state", *(f"goal_{j}_rad" for j in range(1, facts.config.dof + 1))):
        then, now = run.columns[name][:count], records[name][:count]
        differs = np.abs(now - then) > (SAME_RAD if name.endswith("_rad") else 0)
        if differs.any():
            row = int(np.argmax(differs))
            return f"{name} of row {row} is {now[row]}, it was {then[row]}"
    if len(records) != facts.ticks:
        return f"there are {len(records)} ticks, there were {facts.ticks}"
    if (ended, reason) != (facts.ended, facts.reason):
        return f"the end is {ended} ({reason}), it was {facts.ended} ({facts.reason})"
    return ""
