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
    """Reason of a stop.

    Attributes
    ----------
    text : str
        Cause of the stop, then the faults seen later; empty before a stop.
    tripped : bool
        Whether the cause is a fault, not a request.
    faults : set of Fault
        Kinds of fault that caused the stop or were seen later.
    earlier_faults : set of Fault
        Those of the stops before, after which the robot has started again.

    Examples
    --------
    >>> reason = StopReason()
    >>> reason.begin("the motion is over")
    >>> reason.add(Fault.DATA, "no fresh data for 3 ticks")
    >>> reason.add(Fault.DATA, "no fresh data for 4 ticks")  # known
    >>> reason.text, reason.tripped, reason.faults == {Fault.DATA}
    ('the motion is over; then no fresh data for 3 ticks', False, True)
    >>> reason.restart("the port was back")
    >>> reason.begin("the motion is over")
    >>> reason.whole.count("the motion is over"), reason.earlier_faults == {Fault.DATA}
    (2, True)
    """

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
        """Keep this stop as an earlier one: the robot starts again.

        Parameters
        ----------
        cause : str
            Why it may.
        """
        if self.text not in self._earlier:
            self._earlier += [self.text, cause]
        self.earlier_faults |= self.faults
        self.text, self.tripped, self.faults = "", False, set()

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
