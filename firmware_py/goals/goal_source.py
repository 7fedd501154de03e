"""Interface of the goals that the control loop sends, and the fixed table of a motion.

The loop asks a source in every tick, after the estimator and before the supervisor, which checks
each goal and may replace it.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.inference.estimator import Estimate
from firmware_py.tick_log import Tick

__all__ = ["GoalSource", "GoalTable", "OwnGoals"]

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
    trouble : str
        Fault of the source that must stop the robot, as a sentence; empty for none.
    ended : str
        Reason why the run is over without a fault, as a sentence; empty before.
    """

    @property
    def trouble(self) -> str:
        """Fault of the source that must stop the robot; empty for none."""
        ...

    @property
    def ended(self) -> str:
        """Reason why the run is over without a fault; empty before."""
        ...

    @property
    def dof(self) -> int:
        """Number of joints."""
        ...

    @property
    def slots(self) -> int:
        """Number of slots after which the goals repeat."""
        ...

    @property
    def lead(self) -> int:
        """Number of slots of a probing motion before slot 0."""
        ...

    def heed(self, estimate: Estimate, step_s: float) -> None:
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

    trouble = ended = ""
    lead = 0

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

    def heed(self, estimate: Estimate, step_s: float) -> None:
        """Do nothing."""

    def at(self, slot: int) -> Array:
        return np.asarray(self._goals[max(slot, 0) % self.slots])
