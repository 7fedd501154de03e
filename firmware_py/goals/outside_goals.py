"""Goals that another program sends, one message per tick, checked and shaped.

In a tick without a message the goals are extrapolated at their latest rate, in at most
`limits.stale_ticks` - 1 consecutive ticks. A fault of the program leads to a controlled stop with a
reason: a timeout, an answer to an old status, too many messages in a tick, an invalid message, a
position out of reach, an angle or a rate beyond its limit, a closed connection. The supervisor
checks the resulting goals like those of any source.

With a map, tip positions become the goals at which the tip rests there, and all goals pass the
zero-vibration shaper. Both depend on the estimated payload, which is followed at a limited rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.goals.goal_channel import (
    GoalChannel,
    GoalMessage,
    StatusMessage,
    decode_goal,
    encode_status,
)
from firmware_py.goals.goal_map import GoalMap, RestGoals
from firmware_py.goals.goal_source import FollowedPayload
from firmware_py.inference.estimator import Estimate
from firmware_py.safety.limits import Limits
from firmware_py.tick_log import Tick


class ZeroVibration:
    """Zero-vibration shaper of goals whose future is unknown.

    Each goal is sent in two parts, the second half a period of the first mode later and smaller by
    its decay, so that the two vibrations cancel (Singer and Seering, *ASME J. Dynamic Systems* 112,
    1990). The mode may change in every tick, with the estimated payload.
    """

    def __init__(self, start_rad: Sequence[float], longest_s: float, period_s: float) -> None:
        self._period_s = period_s
        self._size = math.ceil(longest_s / period_s) + 2
        self._past = [[value] * self._size for value in start_rad]
        self._latest = 0

    def next(
        self, goal_rad: Sequence[float], half_period_s: Sequence[float], decay: Sequence[float]
    ) -> list[float]:
        """Return the shaped goals of the next tick, one per joint."""
        size = self._size
        now = self._latest = (self._latest + 1) % size
        result = []
        for past, goal, seconds, left in zip(
            self._past, goal_rad, half_period_s, decay, strict=True
        ):
            past[now] = goal
            rows = min(seconds / self._period_s, size - 2.0)
            whole = int(rows)
            near, far = past[(now - whole) % size], past[(now - whole - 1) % size]
            late = near + (rows - whole) * (far - near)
            result.append((goal + left * late) / (1.0 + left))
        return result


Array = NDArray[np.float64]
MOST_IN_A_TICK: Final = 4
"""Most messages in one tick; more are refused as a flood [assumed: the backlog of a program after a
delay as long as goals may be stale]."""
FIRST_WAIT_S: Final = 5.0
"""Timeout for the first goal after the first status [assumed]."""
PAYLOAD_RATE_KG_S: Final = 0.5
"""Largest rate at which the estimated payload is followed, as in plans."""
ENDLESS: Final = 1 << 62
_ROUNDING: Final = 1.0 + 1e-6


class OutsideGoals:
    """Goals of another program as `firmware_py.goals.goal_source.GoalSource`.

    The arm waits with all goals at zero for the first message, whose goals must begin there.

    `goal_map`: goals at rest and modes; without it only joint goals are accepted, unshaped.
    `payload_kg`: known payload; None follows the estimate, starting in the middle of the map.
    `note`: sentence on a difference between the plants of map and bundle.
    """

    def __init__(
        self, channel: GoalChannel, limits: Limits, dof: int, period_s: float,
        goal_map: GoalMap | None = None, payload_kg: float | None = None, note: str = "",
    ) -> None:  # fmt: skip
        self.dof, self.slots, self.lead = dof, ENDLESS, 0
        self.fault = self.ended = ""
        self.note = note
        self._channel, self._limits, self._period_s = channel, limits, period_s
        self._rest = RestGoals(goal_map) if goal_map else None
        self._payload = FollowedPayload([0.0], 0.0, 0.0)
        self._shaper: ZeroVibration | None = None
        if self._rest is not None:
            self._payload = FollowedPayload(self._rest.grid_kg, payload_kg, PAYLOAD_RATE_KG_S)
            self._shaper = ZeroVibration([0.0] * dof, self._rest.longest_s, period_s)
        self._slot, self._reported, self._answered = -1, -1, -1
        self._missing = 0
        self._wanted, self._rate = [0.0] * dof, [0.0] * dof
        self._goal, self._before = np.zeros(dof), np.zeros(dof)

    @property
    def payload_kg(self) -> float:
        """Payload of this tick; 0 without a map."""
        return self._payload.kg

    def follow(self, estimate: Estimate, step_s: float) -> None:
        self._payload.follow(estimate.payload_kg, step_s)

    def at(self, slot: int) -> Array:
        """Return the goals of a slot, shape (dof,); zero before slot 0.

        The first call for a slot also processes the messages received.
        """
        if slot < 0 or slot <= self._slot:
            return self._goal if slot == self._slot else self._before
        steps, self._slot = min(slot - self._slot, 100), slot
        if not (self.fault or self.ended):
            self._process_messages(slot, steps)
        self._goal[:] = self._shaped(steps)
        return self._goal

    def report(self, tick: Tick, reason: str) -> None:
        """Send the program the status after a tick; see `GoalSource.report`."""
        if tick.slot < 0:
            return
        payload, tip = tick.estimate.payload_kg, tick.prediction.tip_m
        self._channel.send(encode_status(StatusMessage(
            tick.slot, tick.slot * self._period_s, tick.state.name, tuple(tick.goal_rad.tolist()),
            tuple(tick.angle_rad.tolist()), tuple(tip.tolist()), bool(tick.prediction.in_range),
            payload if math.isfinite(payload) else None, reason,
        )))  # fmt: skip
        self._reported = tick.slot

    def _process_messages(self, slot: int, steps: int) -> None:
        """Receive and check the messages of this tick, and follow the newest goals."""
        messages = self._channel.receive(MOST_IN_A_TICK + 1)
        if len(messages) > MOST_IN_A_TICK:
            self._refuse(f"sends more than {MOST_IN_A_TICK} goals in a tick")
            return
        newest: list[float] | None = None
        ends = False
        for data in messages:
            message = decode_goal(data, self.dof)
            if isinstance(message, str):
                self._refuse(f"sends a message that {message}")
                return
            if not self._answered <= message.tick <= self._reported:
                span = f"after {self._answered} of {self._reported}"
                self._refuse(f"answers status {message.tick}, {span}")
                return
            self._answered, ends = message.tick, message.end
            if ends:
                break
            if (newest := self._permitted(message)) is None:
                return
        if newest is not None and slot - self._answered > self._limits.stale_ticks:
            self._refuse(f"sends goals that are {slot - self._answered} ticks old")
        elif newest is not None:
            self._missing = 0
            self._take(newest)
        elif not ends and self._channel.gone:
            self._refuse("has gone")
        elif not ends:
            self._miss(slot, steps)
        if ends and not self.fault:
            self.ended = "the program that sends the goals has ended the run"

    def _refuse(self, what: str) -> None:
        self.fault = f"the program that sends the goals {what}"
        self._rate = [0.0] * self.dof

    def _miss(self, slot: int, steps: int) -> None:
        """Extrapolate the goals at their latest rate, until they are stale."""
        if self._answered < 0:
            if slot * self._period_s > FIRST_WAIT_S:
                self._refuse(f"has sent none within {FIRST_WAIT_S:g} s")
            return
        self._missing += steps
        if self._missing >= self._limits.stale_ticks:
            self._refuse(f"has sent none for {self._missing} ticks")
            return
        low, high = self._limits.angle_rad
        ahead_s = steps * self._period_s
        pairs = zip(self._wanted, self._rate, strict=True)
        self._wanted = [min(max(at + ahead_s * rate, low), high) for at, rate in pairs]

    def _permitted(self, message: GoalMessage) -> list[float] | None:
        """Return the goals of a message; None, with `fault` set, if the arm must not go there."""
        goals = list(message.joint_rad or ())
        if message.tip_m is not None:
            if self._rest is None:
                self._refuse("sends places of the tip, but there is no map (--goal-map)")
                return None
            at_rest = self._rest.goals_rad(message.tip_m, self._payload.kg)
            if at_rest is None:
                place = ", ".join(f"{v:g}" for v in message.tip_m)
                self._refuse(f"wants the tip at ({place}) m, which is out of reach")
                return None
            goals = at_rest
        low, high = self._limits.angle_rad
        for joint, value in enumerate(goals):
            if not low <= value <= high:
                what = f"at {value:g} rad, outside {low:g} to {high:g} rad (limits.angle_rad)"
                self._refuse(f"wants joint {joint + 1} {what}")
                return None
        return goals

    def _take(self, goals: list[float]) -> None:
        """Follow goals, unless their rate exceeds the limit."""
        most = self._limits.rate_rad_s
        rates = []
        for joint, (value, before) in enumerate(zip(goals, self._wanted, strict=True)):
            rate = (value - before) / self._period_s
            if not abs(rate) <= most * _ROUNDING:
                what = f"at {rate:.4g} rad/s, the limit is {most:g} rad/s (limits.rate_rad_s)"
                self._refuse(f"moves joint {joint + 1} {what}")
                return
            rates.append(rate)
        self._wanted, self._rate = goals, rates

    def _shaped(self, steps: int) -> list[float]:
        result = self._wanted
        if self._shaper is None or self._rest is None:
            pairs = zip(result, self._rate, strict=True)
            self._before[:] = [at - self._period_s * rate for at, rate in pairs]
            return result
        half_period_s, decay = self._rest.mode(self._payload.kg)
        self._before[:] = self._goal
        for step in range(steps):
            if step:
                self._before[:] = result
            result = self._shaper.next(self._wanted, half_period_s, decay)
        return result
