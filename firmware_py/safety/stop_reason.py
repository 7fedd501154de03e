"""Reason of a stop: its cause, then the faults that were seen while the robot stopped.

A robot that starts again keeps what had stopped it, so that the end of the run tells it.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final

__all__ = ["UNRELEASED", "Fault", "StopReason"]

UNRELEASED: Final = "not every servo confirmed torque off: switch its power off"


class Fault(Enum):
    """Kind of fault; of each kind the first is named."""

    ALERT = auto()
    DATA = auto()
    SLOTS = auto()
    CLOCK = auto()
    MEASUREMENT = auto()
    GOAL = auto()
    TORQUE = auto()
    ESTIMATE = auto()


class StopReason:
    """Reason of a stop."""

    def __init__(self) -> None:
        self.text, self.tripped = "", False
        self.faults: set[Fault] = set()
        self.earlier_faults: set[Fault] = set()
        self._earlier: list[str] = []

    @property
    def whole(self) -> str:
        """Text of the stops before, once each, and of this one; empty before a stop."""
        return "; then ".join([*self._earlier, self.text]) if self.text else ""

    def restart(self, cause: str) -> None:
        """Keep this stop as an earlier one: the robot starts again."""
        if self.text not in self._earlier:
            self._earlier += [self.text, cause]
        self.earlier_faults |= self.faults
        self.text, self.tripped, self.faults = "", False, set()

    def begin(self, text: str, fault: Fault | None = None) -> None:
        """Set the cause of a stop.

        `fault`: its kind; None for a request.
        """
        self.text = text
        self.tripped = fault is not None
        self.faults = set() if fault is None else {fault}

    def add(self, fault: Fault, text: str) -> None:
        """Add a fault that was seen later, unless one of its kind is known."""
        if fault not in self.faults:
            self.faults.add(fault)
            self.text += f"; then {text}"
