"""The safety supervisor: decides in every tick whether the robot may go on, and with which goal.

::

    STARTING ──arm──► READY ──start──► RUNNING ◄──fresh data──┐
        │                                │  └──stale data──► DEGRADED
        ▲                                │                     │ `stale_ticks` in a row
        │                                │ limit, alert,       │
        │                                │ stall, request      │
        │                                ▼                     ▼
        │                             STOPPING ◄───────────────┘
        │ the port is back               │ goals slowed down to rest, held for `hold_s`
        │                                ▼
        └─────────────────────────────  OFF: the loop ends and switches the torque off

`TRANSITIONS` is this drawing as data; the machine can make no other step, and docs/safety.md is
drawn from it.

A limit is the last value allowed: at the limit all is well, beyond it the robot stops. Goals are
judged at once. Measurements must break a limit `persistence_ticks` times in a row, since a single
wild sample is the sensor's fault more often than the arm's.

Goals never jump. What would be a jump, at the start or after missed slots, becomes an offset
between the motion and the goal, which fades away smoothly. A robot that takes up a motion in its
midst, after a replug, goes from rest over into it, never beyond what both keep to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus import BusStatus
from firmware_py.errors import InputError
from firmware_py.registers import describe_hardware_error
from firmware_py.signals import PERIOD_S

Array = NDArray[np.float64]

_ROUNDING: Final = 1.0 + 1e-9
"""A goal at the limit must not trip over the rounding of a difference quotient."""

_BLEND_RATE_SHARE: Final = 0.25
"""Share of the rate limit that fading an offset away may use."""


class State(IntEnum):
    """States of the supervisor; see the module's drawing."""

    STARTING = 0
    READY = 1
    RUNNING = 2
    DEGRADED = 3
    STOPPING = 4
    OFF = 5


class Transition(NamedTuple):
    """A step that the machine may make, and what makes it."""

    source: State
    target: State
    cause: str


TRANSITIONS: Final = (
    Transition(State.STARTING, State.READY, "every joint stands inside `limits.angle_rad`"),
    Transition(State.READY, State.RUNNING, "the torque is on"),
    Transition(State.RUNNING, State.DEGRADED, "the data is stale"),
    Transition(State.DEGRADED, State.RUNNING, "the data is fresh again"),
    Transition(
        State.RUNNING, State.STOPPING,
        "a limit broken, a hardware error, slots missed, the clock set back, a request",
    ),
    Transition(
        State.DEGRADED, State.STOPPING,
        "`limits.stale_ticks` without fresh data, slots missed, a goal beyond a limit, a request",
    ),
    Transition(State.READY, State.STOPPING, "a request before the torque is on"),
    Transition(State.STOPPING, State.OFF, "the goals came to rest and were held for `hold_s`"),
    Transition(State.OFF, State.STARTING, "the port is back within `bus.replug_s`"),
)  # fmt: skip
"""The whole machine; the module's drawing shows it."""

_ALLOWED: Final = frozenset((t.source, t.target) for t in TRANSITIONS)


class Limits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the robot may do (table `[limits]` of robot.toml); the same for every joint.

    Attributes
    ----------
    angle_rad : (float, float)
        Range of goals, and with `following_error_rad` on either side of measured angles.
    rate_rad_s, acceleration_rad_s2 : float
        Of the goals. The study's motion starts at full speed: 0.76 rad/s within one period.
    current_a : float
        Magnitude of the motor current.
    following_error_rad : float
        Distance of the measured angle from the goal sent before it.
    jump_rad : float
        Change of the measured angle from one sample to the next; more is an encoder fault.
    tip_min_m, tip_max_m : (float, float, float)
        Box in the world frame that the predicted tip must stay in.
    persistence_ticks : int
        Samples in a row that must break a limit before the robot stops.
    stale_ticks : int
        Ticks in a row without fresh data, or slots missed in a row, before the robot stops.
    missed_slots : int
        Slots that may be missed over a time, each punctual tick making up for one, before the
        robot stops: a loop that is too slow for its period is no loop.
    blend_s : float
        Least time in which an offset between motion and goal fades away.
    stop_deceleration_rad_s2 : float
        With which goals come to rest in a controlled stop.
    hold_s : float
        How long the last goal is held, torque on, before the torque goes off.
    """

    angle_rad: tuple[float, float] = (-0.6, 0.6)
    rate_rad_s: float = 2.0
    acceleration_rad_s2: float = 60.0
    current_a: float = 8.0
    following_error_rad: float = 0.2
    jump_rad: float = 0.1
    tip_min_m: tuple[float, float, float] = (-1.2, -1.2, 0.0)
    tip_max_m: tuple[float, float, float] = (1.2, 1.2, 1.3)
    persistence_ticks: int = 3
    stale_ticks: int = 3
    missed_slots: int = 12
    blend_s: float = 1.0
    stop_deceleration_rad_s2: float = 6.0
    hold_s: float = 0.5


class SafetySupervisor:
    """The state machine of the module's drawing.

    Parameters
    ----------
    limits : Limits
        What the robot may do.
    dof : int
        Number of joints.
    period_s : float
        Control period.

    Attributes
    ----------
    state : State
        Where it is.
    reason : str
        Why it left RUNNING, one sentence; empty before.
    tripped : bool
        Whether it was a fault, not a request, that stopped the robot.
    stale_ticks : int
        Age of the data in ticks, 0 is fresh.
    goal_rad : ndarray, shape (dof,)
        The goal admitted last.
    """

    def __init__(self, limits: Limits, dof: int, period_s: float = PERIOD_S) -> None:
        self.state, self.reason, self.tripped = State.STARTING, "", False
        self.stale_ticks = 0
        self.goal_rad = np.zeros(dof)
        self._limits, self._dof, self._period_s = limits, dof, period_s
        self._goal = [0.0] * dof
        self._velocity = [0.0] * dof
        self._offset = [0.0] * dof
        self._anchor = [0.0] * dof
        self._anchored = False
        self._angle = [0.0] * dof
        self._blend_tick, self._blend_ticks = 0, 1
        self._strikes = 0
        self._missed_slots = 0
        self._hold_ticks = 0

    # Transitions -------------------------------------------------------------------------------

    def _enter(self, state: State) -> None:
        if (self.state, state) not in _ALLOWED:
            raise ValueError(f"{self.state.name} does not lead to {state.name}")
        self.state = state

    def arm(self, angle_rad: Array) -> None:
        """Take the measured position as the goal to start from: STARTING → READY.

        Raises
        ------
        InputError
            If a joint stands outside the limits.
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
        self._enter(State.READY)

    def start(self) -> None:
        """READY → RUNNING, once the torque is on."""
        self._enter(State.RUNNING)

    def restart(self) -> None:
        """OFF → STARTING, for a robot whose port is back: every check is made again."""
        self._enter(State.STARTING)
        self.reason, self.tripped = "", False
        self.stale_ticks = self._strikes = self._missed_slots = 0
        for joint in range(self._dof):
            self._velocity[joint] = self._offset[joint] = 0.0

    def request_stop(self, reason: str) -> None:
        """Come to a controlled stop for a reason that is no fault (end of the run, a signal)."""
        self._stop(reason, tripped=False)

    def trip(self, reason: str) -> None:
        """Come to a controlled stop for a fault that the loop has found."""
        self._stop(reason)

    def _stop(self, reason: str, *, tripped: bool = True) -> None:
        if self.state < State.STOPPING:
            self._enter(State.STOPPING)
            self.reason, self.tripped = reason, tripped
            self._hold_ticks = max(1, math.ceil(self._limits.hold_s / self._period_s))

    # In every tick -----------------------------------------------------------------------------

    def check(
        self,
        status: BusStatus,
        alert: int,
        angle_rad: Array,
        current_a: Array,
        tip_m: Array,
        di: float,
        missed: int,
    ) -> State:
        """Judge what this tick measured and predicted.

        Parameters
        ----------
        status : BusStatus
            Result of the read.
        alert : int
            Hardware error bits.
        angle_rad, current_a : ndarray, shape (dof,)
            Latest good measurement.
        tip_m : ndarray, shape (3,)
            Predicted tip.
        di : float
            Estimated Deformation Index.
        missed : int
            Slots missed since the previous tick.
        """
        self.stale_ticks = 0 if status.fresh else self.stale_ticks + 1 + missed
        self._missed_slots = (
            self._missed_slots + missed if missed else max(self._missed_slots - 1, 0)
        )
        if self.state is State.RUNNING and self.stale_ticks:
            self._enter(State.DEGRADED)
        elif self.state is State.DEGRADED and not self.stale_ticks:
            self._enter(State.RUNNING)
        if status is BusStatus.ALERT:
            self._stop(f"a servo reports a hardware error ({describe_hardware_error(alert)})")
        elif self.stale_ticks >= self._limits.stale_ticks:
            self._stop(f"no fresh data for {self.stale_ticks} ticks ({status.name})")
        elif missed >= self._limits.stale_ticks:
            self._stop(f"{missed} slots missed in a row")
        elif self._missed_slots > self._limits.missed_slots:
            self._stop(f"{self._missed_slots} slots missed, the loop is too slow for its period")
        if status.fresh:
            self._judge(angle_rad.tolist(), current_a.tolist(), tip_m.tolist(), di)
        return self.state

    def _judge(
        self, angle: Sequence[float], current: Sequence[float], tip: Sequence[float], di: float
    ) -> None:
        complaint = self._complaint(angle, current, tip, di)
        self._angle[:] = angle
        self._strikes = self._strikes + 1 if complaint else 0
        if complaint and self._strikes >= self._limits.persistence_ticks:
            self._stop(complaint)

    def _complaint(
        self, angle: Sequence[float], current: Sequence[float], tip: Sequence[float], di: float
    ) -> str:
        """Name the first limit that a measurement breaks, or nothing."""
        limits = self._limits
        low, high = limits.angle_rad
        margin = limits.following_error_rad
        for joint in range(self._dof):
            who, at = f"joint {joint + 1}", angle[joint]
            if not low - margin <= at <= high + margin:
                return f"{who} is at {at:.3f} rad, outside its limits"
            if not abs(current[joint]) <= limits.current_a:
                return f"{who} draws {current[joint]:.2f} A, the limit is {limits.current_a:g} A"
            if not abs(at - self._goal[joint]) <= margin:
                return (
                    f"{who} is {at - self._goal[joint]:.3f} rad away from its goal, "
                    f"the limit is {margin:g} rad"
                )
            if not abs(at - self._angle[joint]) <= limits.jump_rad:
                return f"{who} jumped by {at - self._angle[joint]:.3f} rad, an encoder fault"
        if not math.isfinite(di):
            return f"the Deformation Index is {di}"
        for k, axis in enumerate("xyz"):
            if not limits.tip_min_m[k] <= tip[k] <= limits.tip_max_m[k]:
                return f"the predicted tip has {axis} = {tip[k]:.3f} m, outside its box"
        return ""

    def rebase(self, wished_before_rad: Array) -> None:
        """Absorb a jump: from here on goals follow the motion with an offset that fades away.

        Parameters
        ----------
        wished_before_rad : ndarray, shape (dof,)
            The motion one period before the goal to come, which the last goal is to stand for;
            the speed of the motion is then kept without a step.
        """
        if self._anchored and self._blend_tick < self._blend_ticks:
            self.resume()
            return
        largest = 0.0
        for joint, wished in enumerate(wished_before_rad.tolist()):
            self._offset[joint] = self._goal[joint] - wished
            largest = max(largest, abs(self._offset[joint]))
        self._anchored = False
        self._begin_blend(largest)

    def resume(self) -> None:
        """Go from where the goals stand over into the motion, wherever it is.

        A goal then lies between the two, so that within the limits it stays within them; an offset
        to a motion that goes on could leave them.
        """
        low, high = self._limits.angle_rad
        farthest = max(max(high - goal, goal - low) for goal in self._goal)
        self._anchor[:] = self._goal
        self._anchored = True
        self._begin_blend(farthest)

    def _begin_blend(self, largest: float) -> None:
        # The fading quintic is steepest at its middle: 1.875 of its mean slope.
        slow_s = 1.875 * largest / (_BLEND_RATE_SHARE * self._limits.rate_rad_s)
        self._blend_tick = 0
        self._blend_ticks = max(1, math.ceil(max(self._limits.blend_s, slow_s) / self._period_s))

    def admit(self, wished_rad: Array) -> Array:
        """Return the goal to send: the wished one as far as it is allowed, else one that stops.

        Parameters
        ----------
        wished_rad : ndarray, shape (dof,)
            Goal of the motion in this tick.

        Returns
        -------
        ndarray, shape (dof,)
            `goal_rad`, overwritten in place.
        """
        if self.state in (State.RUNNING, State.DEGRADED):
            goal = self._blended(wished_rad.tolist())
            if complaint := self._goal_complaint(goal):
                self._stop(complaint)
            else:
                self._accept(goal)
        if self.state is State.STOPPING:
            self._accept(self._slowed())
            if not any(self._velocity):
                self._hold_ticks -= 1
                if self._hold_ticks <= 0:
                    self._enter(State.OFF)
        return self.goal_rad

    def _blended(self, wished_rad: Sequence[float]) -> list[float]:
        share = self._blend_share()
        if self._anchored:
            pairs = zip(wished_rad, self._anchor, strict=True)
            return [wished + share * (anchor - wished) for wished, anchor in pairs]
        pairs = zip(wished_rad, self._offset, strict=True)
        return [wished + share * offset for wished, offset in pairs]

    def _blend_share(self) -> float:
        """Share of the offset that is left: a quintic from 1 to 0, at rest at both ends."""
        self._blend_tick = min(self._blend_tick + 1, self._blend_ticks)
        x = self._blend_tick / self._blend_ticks
        return 1.0 - x * x * x * (10.0 + x * (6.0 * x - 15.0))

    def _goal_complaint(self, goal: Sequence[float]) -> str:
        limits = self._limits
        low, high = limits.angle_rad
        for joint, value in enumerate(goal):
            who = f"the goal of joint {joint + 1}"
            if not low <= value <= high:
                return f"{who} is {value:.3f} rad, outside {low:g} to {high:g} rad"
            rate = (value - self._goal[joint]) / self._period_s
            if not abs(rate) <= limits.rate_rad_s * _ROUNDING:
                return f"{who} moves at {rate:.2f} rad/s, the limit is {limits.rate_rad_s:g} rad/s"
            acceleration = (rate - self._velocity[joint]) / self._period_s
            if not abs(acceleration) <= limits.acceleration_rad_s2 * _ROUNDING:
                return (
                    f"{who} accelerates at {acceleration:.1f} rad/s2, "
                    f"the limit is {limits.acceleration_rad_s2:g} rad/s2"
                )
        return ""

    def _slowed(self) -> list[float]:
        """Goals one period on, with the speed brought towards zero, inside the angle limits."""
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


def check_motion(goals_rad: Array, limits: Limits, period_s: float, where: str) -> None:
    """Refuse a table of goals that the supervisor would stop.

    Parameters
    ----------
    goals_rad : ndarray, shape (n, dof)
        One row a period, from rest at the first row.
    limits : Limits
        What the robot may do.
    period_s : float
        Control period.
    where : str
        What the message calls the motion.

    Raises
    ------
    InputError
        If a goal breaks a limit; it names the first.
    """
    supervisor = SafetySupervisor(limits, goals_rad.shape[1], period_s)
    supervisor.arm(goals_rad[0])
    supervisor.start()
    for row in goals_rad:
        supervisor.admit(row)
        if supervisor.state is not State.RUNNING:
            raise InputError(
                where, supervisor.reason, "make the motion slower or smaller, or widen [limits]"
            )
