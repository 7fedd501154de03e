"""Program that sends goals to the robot of a case, with faults at the scheduled times."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.config import RobotConfig
from firmware_py.goals.goal_channel import GoalMessage, StatusMessage, encode_goal
from firmware_py.goals.goal_map import GoalMap, PayloadMap
from firmware_py.goals.outside_goals import OutsideGoals
from firmware_py.link.link_facts import STUDY_FACTS
from hil.faults.host_faults import HostFaults

Array = NDArray[np.float64]
REACH_M: Final = 0.9
"""Largest tip coordinate in the goal map of a case."""
BEYOND_M: Final = 1.5
"""Tip coordinate out of reach for an arm of 1 m."""
STEP_RAD: Final = 0.2
"""Step of the goal in one tick of a program that is too fast: 12 rad/s."""
FLOOD: Final = 8
"""Messages per tick of a program that floods the channel."""


class GoalProgram:
    """Channel to a program in memory that answers each status with the next row of `goals_rad`.

    Shapes: `goals_rad` (n, dof).
    """

    def __init__(self, goals_rad: Array, host: HostFaults) -> None:
        self.gone = False
        self._goals, self._host = goals_rad, host
        self._waiting: list[bytes] = []
        self._latest: GoalMessage | None = None

    def receive(self, most: int) -> list[bytes]:
        """See `GoalChannel.receive`."""
        taken, self._waiting = self._waiting[:most], self._waiting[most:]
        return taken

    def send(self, data: bytes) -> None:
        """Answer a status; see `GoalChannel.send`."""
        tick, wrong = msgspec.json.decode(data, type=StatusMessage).tick, self._host.value
        self.gone |= wrong("program gone") is not None
        if self.gone or wrong("program silent") is not None:
            return
        goal = GoalMessage(tick, tuple(self._goals[(tick + 1) % len(self._goals)].tolist()))
        if wrong("program stuck") is not None and self._latest is not None:
            goal = self._latest
        if wrong("program too fast") is not None and goal.joint_rad is not None:
            goal = GoalMessage(tick, tuple(value + STEP_RAD for value in goal.joint_rad))
        if wrong("program out of reach") is not None:
            goal = GoalMessage(tick, None, (BEYOND_M,) * self._goals.shape[1])
        message = encode_goal(goal)
        if wrong("program malformed") is not None:
            message = message[:-1]
        self._waiting += [message] * (FLOOD if wrong("program flooding") is not None else 1)
        self._latest = goal


def program_goals(config: RobotConfig, goals_rad: Array, host: HostFaults) -> OutsideGoals:
    """Return a source of goals that a program sends.

    Shapes: `goals_rad` (n, dof).
    """
    channel = GoalProgram(goals_rad, host)
    goal_map = _rigid_map(config.dof, config.period_s)
    return OutsideGoals(channel, config.limits_in_force, config.dof, config.period_s, goal_map)


def _rigid_map(dof: int, period_s: float) -> GoalMap:
    """Goal map of a rigid link of 1 m without vibration; both steps of a goal take one period."""
    places = np.linspace(-REACH_M, REACH_M, 7)
    grid = np.stack(np.meshgrid(*[places] * dof, indexing="ij"), axis=-1).reshape(-1, dof)
    own = PayloadMap(
        payload_kg=1.0, goals_rad=tuple(tuple(c) for c in np.arcsin(grid).T.tolist()),
        half_period_s=(period_s,) * dof, decay=(0.5,) * dof,
    )  # fmt: skip
    return GoalMap(
        schema=GoalMap.VERSION, dof=dof, period_s=period_s, places_m=tuple(places.tolist()),
        payloads=(own,), plant_sha256="", link=STUDY_FACTS,
    )  # fmt: skip
