"""Reason of a stop: its cause, then the faults detected while the robot stopped.

A robot that starts again keeps the reasons of earlier stops, for the summary of the run.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final

__all__ = ["UNRELEASED", "Fault", "StopReason"]

UNRELEASED: Final = "not every servo confirmed torque off: switch its power off"


class Fault(Enum):
    """Kind of fault; a reason names the first of each kind."""

    ALERT = auto()
    DATA = auto()
    SLOTS = auto()
    CLOCK = auto()
    MEASUREMENT = auto()
    FROZEN = auto()
    GOAL = auto()
    TORQUE = auto()
    ESTIMATE = auto()


class StopReason:
    def __init__(self) -> None:
        self.text, self.tripped = "", False
        self.faults: set[Fault] = set()
        self.earlier_faults: set[Fault] = set()
        self._earlier: list[str] = []

    @property
    def whole(self) -> str:
        """Text of the earlier stops, once each, and of this one; empty before a stop."""
        return "; then ".join([*self._earlier, self.text]) if self.text else ""

    def restart(self, cause: str) -> None:
        """Store this stop as an earlier one, since the robot starts again."""
        if self.text not in self._earlier:
            self._earlier += [self.text, cause]
        self.earlier_faults |= self.faults
        self.text, self.tripped, self.faults = "", False, set()

    def begin(self, text: str, fault: Fault | None = None) -> None:
        """Set the cause of a stop; a requested stop has no fault."""
        self.text = text
        self.tripped = fault is not None
        self.faults = set() if fault is None else {fault}

    def add(self, fault: Fault, text: str) -> None:
        """Add a fault detected later, unless the reason already has one of its kind."""
        if fault not in self.faults:
            self.faults.add(fault)
            self.text += f"; then {text}"
