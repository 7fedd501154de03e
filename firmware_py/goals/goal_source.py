"""Interface of the goals that the control loop sends, and the fixed table of a motion.

The loop asks a source in every tick, after the estimator and before the supervisor, which checks
each goal and may replace it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.inference.estimator import Estimate
from firmware_py.tick_log import Tick

Array = NDArray[np.float64]


class GoalSource(Protocol):
    """Interface of a source of goals.

    Before slot 0 its goals are those of slot 0, or a probing motion; after the last slot they
    repeat from the first.

    Attributes
    ----------
    dof : int
        Number of joints.
    slots : int
        Number of slots after which the goals repeat.
    lead : int
        Number of slots of a probing motion before slot 0; 0 without one.
    fault : str
        Fault of the source that must stop the robot, as a sentence; empty for none.
    ended : str
        Reason why the run is over without a fault, as a sentence; empty before.
    """

    dof: int
    slots: int
    lead: int
    fault: str
    ended: str

    def follow(self, estimate: Estimate, step_s: float) -> None:
        """Process the estimate of a tick, before `at`.

        Parameters
        ----------
        estimate : Estimate
            Deformation Index and payload in this tick.
        step_s : float
            Time since the previous tick in s.
        """

    def at(self, slot: int) -> Array:
        """Return the goals of a slot.

        Parameters
        ----------
        slot : int
            Number of the slot; negative during approach and probing motion.

        Returns
        -------
        ndarray, shape (dof,)
            Goal angles in rad.
        """
        ...

    def report(self, tick: Tick, reason: str) -> None:
        """Process the result of a tick, at its end.

        Parameters
        ----------
        tick : Tick
            Measurements, estimates, goals sent and state.
        reason : str
            Reason of the stop; empty before one.
        """


class OwnGoals:
    """Base of sources whose goals come from the robot itself, so that they are known in advance."""

    fault = ended = ""
    lead = 0

    def follow(self, estimate: Estimate, step_s: float) -> None:
        """Do nothing."""

    def report(self, tick: Tick, reason: str) -> None:
        """Do nothing."""


class GoalTable(OwnGoals):
    """Fixed table of goals, shape (n, dof), which depends on no estimate."""

    def __init__(self, goals_rad: Array) -> None:
        if goals_rad.ndim != 2 or min(goals_rad.shape) < 1:
            raise InputError(
                "motion", f"has goals of shape {goals_rad.shape}", "give one row per slot"
            )
        self._goals = np.ascontiguousarray(goals_rad, dtype=np.float64)
        self.slots, self.dof = self._goals.shape

    def at(self, slot: int) -> Array:
        return np.asarray(self._goals[max(slot, 0) % self.slots])


class FollowedPayload:
    """Payload on a grid: the known one, or the estimate, followed at a limited rate.

    So goals do not jump with the estimate. It starts in the middle of the grid.
    """

    def __init__(self, grid_kg: Sequence[float], known_kg: float | None, rate_kg_s: float) -> None:
        self._low_kg, self._high_kg, self._rate_kg_s = grid_kg[0], grid_kg[-1], rate_kg_s
        self.is_known = known_kg is not None
        self.kg = 0.5 * (self._low_kg + self._high_kg) if known_kg is None else float(known_kg)

    def follow(self, estimated_kg: float, step_s: float) -> None:
        """Move towards an estimate; ignore one that is not finite."""
        if self.is_known or not math.isfinite(estimated_kg):
            return
        wanted_kg = min(max(estimated_kg, self._low_kg), self._high_kg)
        most_kg = self._rate_kg_s * step_s
        self.kg += min(max(wanted_kg - self.kg, -most_kg), most_kg)


def interval_of(grid: Sequence[float], value: float) -> tuple[int, float]:
    """Return the interval of a rising grid that contains a value, and the fraction along it.

    A value beyond the grid counts as its end; a grid of one node has the interval (0, 0.0).
    """
    if len(grid) == 1:
        return 0, 0.0
    k = 0
    while k < len(grid) - 2 and value > grid[k + 1]:
        k += 1
    return k, min(max((value - grid[k]) / (grid[k + 1] - grid[k]), 0.0), 1.0)
