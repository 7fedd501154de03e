"""Interface of the goals that the control loop sends, and the fixed table of a motion.

The loop asks a source in every tick, after the estimator and before the supervisor, which has the
last word on each goal.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.inference.estimator import Estimate
from firmware_py.tick_log import Tick

__all__ = ["GoalSource", "GoalTable", "OwnGoals"]

Array = NDArray[np.float64]


class GoalSource(Protocol):
    """Goals of every slot; before slot 0 those of slot 0, after the last again from the first.

    Attributes
    ----------
    dof : int
        Number of joints.
    slots : int
        Slots after which the goals repeat.
    lead : int
        Slots before slot 0 in which the goals move already: those of a probing motion.
    trouble : str
        Why the robot must stop; empty as long as the source can be trusted.
    ended : str
        Why the run is over without a fault; empty before.
    """

    @property
    def trouble(self) -> str:
        """Why the robot must stop."""
        ...

    @property
    def ended(self) -> str:
        """Why the run is over."""
        ...

    @property
    def dof(self) -> int:
        """Number of joints."""
        ...

    @property
    def slots(self) -> int:
        """Slots after which the goals repeat."""
        ...

    @property
    def lead(self) -> int:
        """Slots before slot 0 in which the goals move already."""
        ...

    def heed(self, estimate: Estimate, step_s: float) -> None:
        """Take the estimate of a tick.

        Parameters
        ----------
        estimate : Estimate
            Of the estimator, in this tick.
        step_s : float
            Time since the previous tick.
        """

    def at(self, slot: int) -> Array:
        """Return the goals of a slot, shape (dof,).

        Parameters
        ----------
        slot : int
            Number of the slot; negative during the approach.
        """
        ...

    def report(self, tick: Tick, reason: str) -> None:
        """Take what became of a tick, at its end.

        Parameters
        ----------
        tick : Tick
            The tick.
        reason : str
            Cause of a stop; empty before.
        """


class OwnGoals:
    """Base of sources that nothing outside of the robot can disturb."""

    trouble = ended = ""
    lead = 0

    def report(self, tick: Tick, reason: str) -> None:
        """Do nothing."""


class GoalTable(OwnGoals):
    """Table of goals that depends on no estimate.

    Shapes: `goals_rad` (n, dof).
    """

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
        """Return the goals of a slot; see `GoalSource.at`."""
        return np.asarray(self._goals[max(slot, 0) % self.slots])
