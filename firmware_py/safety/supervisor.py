"""Safety supervisor: it decides in every tick whether the robot continues, and with which goal.

States and transitions are in `firmware_py.safety.states`, limits in `firmware_py.safety.limits`. A
goal beyond a limit stops the robot at once. A measurement stops it only after `persistence_ticks`
consecutive violations, since a single outlier is more often a sensor fault than a fault of the
arm. Goals never jump, they blend (`firmware_py.safety.blend`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.registers import describe_alert
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.safety.blend import Blend
from firmware_py.safety.limits import FrozenFeedback, Limits
from firmware_py.safety.states import ALLOWED, UNRELEASED, Fault, SafetyState, StopReason

Array = NDArray[np.float64]


class SafetySupervisor:
    """State machine of `firmware_py.safety.states`."""

    def __init__(self, limits: Limits, dof: int, period_s: float = PERIOD_S) -> None:
        self.state = SafetyState.STARTING
        self.stale_ticks = 0
        self.goal_rad = np.zeros(dof)
        self._limits, self._dof, self._period_s = limits, dof, period_s
        self._goal = [0.0] * dof
        self._velocity = [0.0] * dof
        self._angle = [0.0] * dof
        self._blend = Blend(limits, dof, period_s)
        self._frozen = FrozenFeedback(dof, limits.frozen_ticks)
        self._violations = self._missed_slots = 0
        self._hold_ticks = 0
        self._reason = StopReason()

    @property
    def reason(self) -> str:
        """Reasons of all stops so far, the latest last; empty before a stop."""
        return self._reason.whole

    @property
    def tripped(self) -> bool:
        """Whether the latest stop was caused by a fault, not by a request."""
        return self._reason.tripped

    @property
    def faults(self) -> frozenset[Fault]:
        """Kinds of fault that stopped the robot or were detected while it stopped, all stops."""
        return frozenset(self._reason.faults | self._reason.earlier_faults)

    @property
    def following(self) -> bool:
        """Whether the goals follow the motion, without a stop or a blend in progress."""
        return self.state in (SafetyState.RUNNING, SafetyState.DEGRADED) and not self._blend.active

    def _enter(self, state: SafetyState) -> None:
        if (self.state, state) not in ALLOWED:
            raise ValueError(f"{self.state.name} does not lead to {state.name}")
        self.state = state

    def arm(self, angle_rad: Array) -> None:
        """Take the measured position as the first goal: STARTING → READY.

        Shapes: `angle_rad` (dof,).
        """
        low, high = self._limits.angle_rad
        for joint, angle in enumerate(angle_rad.tolist()):
            if not low <= angle <= high:
                raise InputError(
                    f"joint {joint + 1}",
                    f"stands at {angle:.3f} rad, outside {low:g} to {high:g} rad",
                    "move it by hand into limits.angle_rad before the start",
                )
            self._goal[joint] = self._angle[joint] = self.goal_rad[joint] = angle
        self._enter(SafetyState.READY)

    def start(self) -> None:
        """Start, with the torque on: READY → RUNNING."""
        self._enter(SafetyState.RUNNING)

    def restart(self) -> None:
        """Restart after the port came back: OFF → STARTING; keep the reason of the stop."""
        self._enter(SafetyState.STARTING)
        self._reason.restart("the port was back")
        self.stale_ticks = self._violations = self._missed_slots = 0
        self._frozen.reset()
        self._velocity[:] = [0.0] * self._dof  # the arm is at rest

    def request_stop(self, reason: str) -> None:
        """Begin a controlled stop without a fault (end of the motion, a signal)."""
        if self.state < SafetyState.STOPPING:
            self._begin_stop()
            self._reason.begin(reason)

    def trip(self, reason: str, fault: Fault = Fault.CLOCK) -> None:
        """Begin a controlled stop because of a fault that the loop detected."""
        self._stop(fault, reason)

    def conclude(self, alert: int, *, released: bool) -> None:
        """Add faults at torque off to the reason: alert bits, servos that did not confirm it."""
        if alert:
            self._reason.add(Fault.ALERT, _alert_reason(alert))
        if not released:
            self._reason.add(Fault.TORQUE, UNRELEASED)

    def _stop(self, fault: Fault, reason: str, *, ends_hold: bool = False) -> None:
        """Stop because of a fault; if the robot is already stopping, add the fault to the reason.

        `ends_hold`: whether to skip the rest of the hold, where torque off is safer than holding.
        """
        if self.state < SafetyState.STOPPING:
            self._begin_stop()
            self._reason.begin(reason, fault)
            return
        self._reason.add(fault, reason)
        if ends_hold:
            self._hold_ticks = 0

    def _begin_stop(self) -> None:
        self._enter(SafetyState.STOPPING)
        self._hold_ticks = max(1, math.ceil(self._limits.hold_s / self._period_s))

    def check(
        self,
        status: BusStatus,
        alert: int,
        angle_rad: Array,
        current_a: Array,
        tip_m: Array,
        di: float,
        missed: int,
    ) -> SafetyState:
        """Check the measurement and the prediction of a tick; return the state.

        Shapes: `angle_rad`, `current_a` (dof,), `tip_m` (3,).
        """
        self.stale_ticks = 0 if status.fresh else self.stale_ticks + 1 + missed
        self._missed_slots = (
            self._missed_slots + missed if missed else max(self._missed_slots - 1, 0)
        )
        if self.state is SafetyState.RUNNING and self.stale_ticks:
            self._enter(SafetyState.DEGRADED)
        elif self.state is SafetyState.DEGRADED and not self.stale_ticks:
            self._enter(SafetyState.RUNNING)
        if status is BusStatus.ALERT:
            self._stop(Fault.ALERT, _alert_reason(alert), ends_hold=True)
        elif self.stale_ticks >= self._limits.stale_ticks:
            data = f"no fresh data for {self.stale_ticks} ticks ({status.name})"
            self._stop(Fault.DATA, data, ends_hold=status is BusStatus.PORT_GONE)
        elif missed >= self._limits.stale_ticks:
            self._stop(Fault.SLOTS, f"{missed} slots missed in a row")
        elif self._missed_slots > self._limits.missed_slots:
            slots = f"{self._missed_slots} slots missed, the loop is too slow for its period"
            self._stop(Fault.SLOTS, slots)
        if status.fresh:
            self._judge(angle_rad.tolist(), current_a.tolist(), tip_m.tolist(), di)
        return self.state

    def _judge(
        self, angle: Sequence[float], current: Sequence[float], tip: Sequence[float], di: float
    ) -> None:
        violation = self._limits.sample_violation(
            angle, current, tip, di, goal=self._goal, angle_before=self._angle
        )
        self._angle[:] = angle
        self._violations = self._violations + 1 if violation else 0
        if violation and self._violations >= self._limits.persistence_ticks:
            self._stop(Fault.MEASUREMENT, violation, ends_hold=True)
        if (joint := self._frozen.joint(angle, current, self._goal)) is not None:
            frozen = (
                f"joint {joint + 1} repeats angle and current for {self._limits.frozen_ticks} "
                "samples although its goal moves (limits.frozen_ticks)"
            )
            self._stop(Fault.FROZEN, frozen, ends_hold=True)

    def approach(self, start_rad: Array) -> int:
        """Start the approach to the first goal of the motion; return its duration in ticks.

        `start_rad`: first goal of the motion, shape (dof,); pass it to `admit` in each of these
        ticks.
        """
        return self._blend.approach(self._goal, start_rad.tolist())

    def rebase(self, desired_before_rad: Array) -> None:
        """Absorb a jump after missed slots: goals follow the motion with a decaying offset.

        `desired_before_rad`: the motion one period before the next goal, shape (dof,). The offset
        starts as the difference of the latest goal to it, which keeps the speed of the motion.
        """
        self._blend.absorb(self._goal, desired_before_rad.tolist())

    def resume(self, ahead: Iterable[Array] = ()) -> None:
        """Blend from rest into the running motion after a replug.

        `ahead`: goals of the motion from the next tick on; empty if they are not known.
        """
        self._blend.join(self._goal, (row.tolist() for row in ahead))

    def admit(self, desired_rad: Array) -> Array:
        """Return the goal to send: the desired one if it is permitted, else one that stops.

        Shapes: `desired_rad` (dof,). The result is `goal_rad`, overwritten in every tick.
        """
        if self.state in (SafetyState.RUNNING, SafetyState.DEGRADED):
            goal = self._blend.next(desired_rad.tolist())
            violation = self._limits.goal_violation(
                goal, before=self._goal, velocity=self._velocity, period_s=self._period_s
            )
            if violation:
                self._stop(Fault.GOAL, violation)
            else:
                self._accept(goal)
        if self.state is SafetyState.STOPPING:
            self._accept(self._slowed())
            if not any(self._velocity):
                self._hold_ticks -= 1
                if self._hold_ticks <= 0:
                    self._enter(SafetyState.OFF)
        return self.goal_rad

    def _slowed(self) -> list[float]:
        """Return the next goals of a controlled stop, inside the angle limits."""
        low, high = self._limits.angle_rad
        step = self._limits.stop_deceleration_rad_s2 * self._period_s
        goal = []
        for value, velocity in zip(self._goal, self._velocity, strict=True):
            slower = math.copysign(max(abs(velocity) - step, 0.0), velocity)
            goal.append(min(max(value + slower * self._period_s, low), high))
        return goal

    def _accept(self, goal: Sequence[float]) -> None:
        for joint, value in enumerate(goal):
            self._velocity[joint] = (value - self._goal[joint]) / self._period_s
            self._goal[joint] = self.goal_rad[joint] = value


def _alert_reason(alert: int) -> str:
    return f"a servo raises an alert ({describe_alert(alert)})"


def check_motion(goals_rad: Array, limits: Limits, period_s: float, where: str) -> None:
    """Refuse a table of goals that would make the supervisor stop the robot.

    `goals_rad`: one row per period, shape (n, dof), from rest at the first row.
    """
    remedy = "make the motion slower or smaller, or widen [limits]"
    start_rad, rest = goals_rad[0].tolist(), [0.0] * goals_rad.shape[1]
    if wrong := limits.goal_violation(
        start_rad, before=start_rad, velocity=rest, period_s=period_s
    ):
        raise InputError(where, wrong, remedy)
    supervisor = SafetySupervisor(limits, goals_rad.shape[1], period_s)
    supervisor.arm(goals_rad[0])
    supervisor.start()
    for row in goals_rad:
        supervisor.admit(row)
        if supervisor.state is not SafetyState.RUNNING:
            raise InputError(where, supervisor.reason, remedy)
