"""Control loop: read → estimate → predict → command → check → write → log, every 17 ms.

The same class runs on the robot, against an emulated servo and in simulated time; only bus and
clock differ.

- Slot k starts at the absolute time `start + k * period`, and the motion begins with slot 0. In
  the slots before it the arm approaches its first goal; with a plan that probes, it then probes
  its link.
- After a tick that overruns, the slots that have already begun are skipped. This keeps the phase,
  and no two ticks run in one slot.
- The remaining time of the tick bounds every wait for the bus.
- A tick allocates no net memory and touches no disk; the garbage collector is disabled
  (`firmware_py.system.clock.real_time`).
- `run` always ends with torque off. If a disconnected port comes back within `replug_s`, the robot
  repeats every check and starts again from its measured position.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import RESERVE_NS
from firmware_py.bus.servo_bus import BusStatus, ServoBus
from firmware_py.core.errors import InputError, SafetyTrip
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.goal_source import GoalSource, OwnGoals
from firmware_py.goals.tip_feedback import Correction
from firmware_py.inference.estimator import DeformationEstimator, SampleHold
from firmware_py.inference.predictor import Predictor
from firmware_py.log.telemetry import Telemetry
from firmware_py.safety.states import UNRELEASED, Fault, SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.summary import Ended, RunSummary
from firmware_py.system.clock import Clock
from firmware_py.system.kernel_counters import Counters
from firmware_py.system.service import Service
from firmware_py.system.stop_signals import signals_to
from firmware_py.tick_log import LONGEST_STEP_SLOTS, Tick, TickLog

_START_DELAY_NS: Final = 2_000_000
_REPLUG_POLL_NS: Final = 50_000_000


class ControlLoop:
    """Control loop that drives the servos along the goals of a source.

    `goals`: goals of each slot, usually a table; see `firmware_py.goals.goal_source`.
    `slots`: slots to run before the controlled stop; the goals repeat. None runs the goals once.
    `replug_s`: timeout for a disconnected port after the robot has stopped; 0 does not wait.
    `counters`: the kernel's counters; create them in the thread that calls `run`.
    """

    def __init__(
        self,
        bus: ServoBus,
        estimator: DeformationEstimator,
        predictor: Predictor,
        supervisor: SafetySupervisor,
        goals: GoalSource,
        clock: Clock,
        *,
        correction: Correction | None = None,
        slots: int | None = None,
        period_s: float = PERIOD_S,
        reply_timeout_s: float = 0.008,
        replug_s: float = 0.0,
        telemetry: Telemetry | None = None,
        counters: Counters | None = None,
        service: Service | None = None,
        keep: int = 4096,
    ) -> None:
        if goals.dof != bus.dof:
            raise InputError(
                "motion", f"has goals for {goals.dof} joints, the bus has {bus.dof} joints",
                "give one column per joint",
            )  # fmt: skip
        self._bus, self._clock, self._supervisor = bus, clock, supervisor
        self._estimator, self._predictor = SampleHold(estimator), predictor
        self._goals, self._correction = goals, correction or Correction(bus.dof)
        self._slots = goals.slots if slots is None else slots
        self._period_ns = round(period_s * 1e9)
        self._period_s = self._period_ns * 1e-9
        self._timeout_ns = min(round(reply_timeout_s * 1e9), self._period_ns)
        self._replug_ns = round(replug_s * 1e9)
        self._service = service or Service()
        self._log = TickLog(
            bus.dof, self._period_ns, telemetry or Telemetry(), counters or Counters(), keep
        )
        self._signal = ""
        self._ended = Ended.FINISHED
        self._previous_slot = -1
        self._start_ns: int | None = None
        self._bus_status = BusStatus.OK
        self._replugs = 0
        self._rejoining, self._ran_slot, self._away_ticks = False, -1, 0

    def stop(self, reason: str) -> None:
        """Request a controlled stop, also from a signal handler or another thread."""
        self._signal = reason

    def run(self) -> RunSummary:
        """Connect, run until the motion ends or the robot stops, and switch the torque off."""
        self._bus.connect()
        self._get_ready()
        with signals_to(self.stop):  # includes torque off: a second Ctrl-C must not skip it
            try:
                self._start()
                self._run_slots()
                while self._port_is_back():
                    self._start()
                    self._run_slots()
            except BaseException as error:
                if not self._released():
                    if self._supervisor.state is SafetyState.READY:  # never switched on
                        raise SafetyTrip(f"{error} {UNRELEASED}") from error
                    error.add_note(UNRELEASED)
                raise
            released = self._released()
        return self._summary(released)

    def _released(self) -> bool:
        """Switch the torque off; return whether every servo confirmed it."""
        released = self._bus.torque(False) is BusStatus.OK
        self._log.hand_over()
        return released

    def _get_ready(self) -> None:
        """Take the measured position as the first goal, and reset the estimator; torque is off."""
        self._supervisor.arm(self._bus.angle_rad)
        self._estimator.reset()

    def _start(self) -> None:
        """Switch the torque on at the measured position."""
        bus, supervisor = self._bus, self._supervisor
        bus.write(supervisor.goal_rad, self._clock.now_ns() + self._period_ns)
        if (status := bus.torque(True)) != BusStatus.OK:
            raise InputError(
                "torque", f"cannot be switched on ({status.name})",
                "check cabling and power of the servos",
            )  # fmt: skip
        supervisor.start()

    def _port_is_back(self) -> bool:
        """Wait for a disconnected port and prepare a restart; False if it does not come back."""
        clock, deadline_ns = self._clock, self._clock.now_ns() + self._replug_ns
        if (
            self._bus_status is not BusStatus.PORT_GONE
            or not self._supervisor.tripped
            or self._bus.alert
        ):
            return False
        while clock.now_ns() < deadline_ns and not self._signal:
            clock.sleep_until(clock.now_ns() + _REPLUG_POLL_NS)
            self._service.alive()
            if not self._bus.reopen():
                continue
            with contextlib.suppress(InputError):  # the servos may need longer than the port
                self._bus.connect()
                break
        else:
            return False
        self._supervisor.restart()
        self._get_ready()
        self._supervisor.resume(self._ahead())
        self._replugs += 1
        self._rejoining = True
        return True

    def _run_slots(self) -> None:
        clock, period_ns = self._clock, self._period_ns
        self._log.start()
        if self._start_ns is None:
            slots_before = self._supervisor.approach(self._goals.at(0)) + self._goals.lead
            self._start_ns = clock.now_ns() + slots_before * period_ns + _START_DELAY_NS
        start_ns = self._start_ns
        slot = -((start_ns - clock.now_ns()) // period_ns)
        self._previous_slot = slot - 1
        while self._supervisor.state is not SafetyState.OFF:
            deadline_ns = start_ns + slot * period_ns
            if deadline_ns - clock.now_ns() > 2 * period_ns:
                self._supervisor.trip("the clock was set back")
                self._start_ns = start_ns = clock.now_ns() - slot * period_ns
                continue
            clock.sleep_until(deadline_ns)
            end_ns = self._tick(slot, deadline_ns)
            if slot >= 0 and self._supervisor.state < SafetyState.STOPPING:
                self._count_away(slot)
            # Continue with the first slot that has not begun; missed slots are skipped.
            slot = max(slot + 1, -((start_ns - end_ns) // period_ns))

    def _count_away(self, slot: int) -> None:
        """After a replug, count the slots until the goals have joined the motion again."""
        if self._rejoining:
            following = self._supervisor.following
            self._away_ticks += slot - self._ran_slot - following
            self._rejoining = not following
        self._ran_slot = slot

    def _ahead(self) -> Iterator[NDArray[np.float64]]:
        """Yield the goals from the next slot on; none if another program sends them."""
        slot = -(((self._start_ns or 0) - self._clock.now_ns()) // self._period_ns)
        while isinstance(self._goals, OwnGoals):
            yield self._goals.at(slot) + self._correction.value_rad
            slot += 1

    def _tick(self, slot: int, deadline_ns: int) -> int:
        """Run one tick; return the time of its end."""
        bus, supervisor, goals, now = self._bus, self._supervisor, self._goals, self._clock.now_ns
        wake_ns = now()
        missed = slot - self._previous_slot - 1
        self._previous_slot = slot
        waited_ns = bus.wait_ns

        limit_ns = min(wake_ns + self._timeout_ns, deadline_ns + self._period_ns - RESERVE_NS)
        status = bus.read(limit_ns)
        read_ns = now()
        late_ns = wake_ns - deadline_ns + bus.late_ns
        self._log.start_computing()

        hold, step_s = self._estimator, min(missed + 1, LONGEST_STEP_SLOTS) * self._period_s
        estimate = hold.update(bus.angle_rad, bus.current_a, step_s, status.fresh, late_ns * 1e-9)
        estimate_ns = now()

        prediction = self._predictor.predict(
            bus.angle_rad, bus.current_a, estimate.di, estimate.signals, hold.age_s
        )
        predict_ns = now()

        goals.follow(estimate, step_s)
        correction = self._correction
        if missed:
            supervisor.rebase(goals.at(slot - 1) + correction.value_rad)
        desired_rad = goals.at(slot) + correction.update(
            slot, step_s, status.fresh, bus.current_a, estimate, prediction, supervisor.following
        )
        command_ns = now()

        supervisor.check(
            status, bus.alert, bus.angle_rad, bus.current_a, prediction.tip_m, estimate.di, missed
        )
        if goals.fault and supervisor.state < SafetyState.STOPPING:
            supervisor.trip(goals.fault, Fault.GOAL)
        if correction.stop_reason and supervisor.state < SafetyState.STOPPING:
            supervisor.trip(correction.stop_reason, Fault.ESTIMATE)
        self._stop_on_request(slot)
        goal_rad = supervisor.admit(desired_rad)
        check_ns = now()

        self._bus_status = status = max(status, bus.write(goal_rad, deadline_ns + self._period_ns))
        marks_ns = (
            deadline_ns, wake_ns, read_ns, estimate_ns, predict_ns, command_ns, check_ns, now(),
        )  # fmt: skip

        self._log.hand_over()
        self._service.alive()
        tick = Tick(
            slot, missed, goal_rad, bus.angle_rad, bus.current_a, estimate, prediction,
            supervisor.state, correction.trust, status, supervisor.stale_ticks, bus.alert,
            bus.wait_ns - waited_ns, late_ns, marks_ns,
        )  # fmt: skip
        self._log.append(tick)
        goals.report(tick, supervisor.reason)
        end_ns = now()
        self._log.close(end_ns)
        return end_ns

    def _stop_on_request(self, slot: int) -> None:
        """Begin the controlled stop on request, or when the motion is over."""
        if self._signal:
            self._end(Ended.SIGNALLED, self._signal)
        elif self._goals.ended:
            self._end(Ended.FINISHED, self._goals.ended)
        elif slot >= self._slots:
            self._end(Ended.FINISHED, "the motion is over")

    def _end(self, ended: Ended, reason: str) -> None:
        if self._supervisor.state < SafetyState.STOPPING:
            self._ended = ended
            self._supervisor.request_stop(reason)

    def _summary(self, released: bool) -> RunSummary:
        supervisor, log = self._supervisor, self._log
        supervisor.conclude(self._bus.alert, released=released)
        reason = supervisor.reason
        if self._away_ticks:
            reason += f"; for {self._away_ticks} ticks the goals were not those of the motion"
        return RunSummary(
            ended=Ended.TRIPPED if supervisor.faults else self._ended,
            reason=reason,
            ticks=log.ticks,
            bus_faults=log.bus_faults(),
            out_of_range=log.out_of_range,
            held_up_ticks=log.held_up,
            timing=log.timing,
            records=log.records(),
            telemetry_drops=log.drops,
            replugs=self._replugs,
            released=released,
            faults=supervisor.faults,
            feedback=log.feedback(self._correction.lost_because),
        )
