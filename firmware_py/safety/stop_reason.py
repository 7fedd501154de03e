"""Reason of a stop: its cause, then the faults that were seen while the robot stopped."""

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
    """Reason of a stop.

    Attributes
    ----------
    text : str
        Cause of the stop, then the faults seen later; empty before a stop.
    tripped : bool
        Whether the cause is a fault, not a request.
    faults : set of Fault
        Kinds of fault that caused the stop or were seen later.

    Examples
    --------
    >>> reason = StopReason()
    >>> reason.begin("the motion is over")
    >>> reason.add(Fault.DATA, "no fresh data for 3 ticks")
    >>> reason.add(Fault.DATA, "no fresh data for 4 ticks")  # known
    >>> reason.text, reason.tripped, reason.faults == {Fault.DATA}
    ('the motion is over; then no fresh data for 3 ticks', False, True)
    """

    def __init__(self) -> None:
        self.text, self.tripped = "", False
        self.faults: set[Fault] = set()

    def begin(self, text: str, fault: Fault | None = None) -> None:
        """Set the cause of a stop.

        Parameters
        ----------
        text : str
            The cause, one sentence.
        fault : Fault, optional
            Its kind; None for a request.
        """
        self.text = text
        self.tripped = fault is not None
        self.faults = set() if fault is None else {fault}

    def add(self, fault: Fault, text: str) -> None:
        """Add a fault that was seen later, unless one of its kind is known.

        Parameters
        ----------
        fault : Fault
            Kind of the fault.
        text : str
            The fault, one sentence.
        """
        if fault not in self.faults:
            self.faults.add(fault)
            self.text += f"; then {text}"
