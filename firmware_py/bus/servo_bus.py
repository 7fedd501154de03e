"""Interface between loop and servos: angles and currents in, goals out, faults as values.

A fault never raises inside the loop. `read` and `write` return a `BusStatus`; the arrays keep the
last valid measurement, and the caller knows its age from the number of reads since.
`firmware_py.bus.dynamixel` implements the interface.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["BusStatus", "ServoBus"]

Array = NDArray[np.float64]


class BusStatus(IntEnum):
    """Result of one exchange with the servos; from TIMEOUT on, the data is not fresh."""

    OK = 0
    RETRIED = 1
    """Fresh data, from the second read of the tick."""
    ALERT = 2
    """Fresh data; at least one servo reports a hardware error, or does not drive although it
    should."""
    TIMEOUT = 3
    """An answer was missing at the deadline."""
    CORRUPT = 4
    """An answer was damaged."""
    REFUSED = 5
    """A servo refused the instruction."""
    PORT_GONE = 6
    """The device has disappeared."""

    @property
    def fresh(self) -> bool:
        """Whether the arrays hold a measurement of this read."""
        return self <= BusStatus.ALERT


class ServoBus(Protocol):
    """Bus as the loop uses it: real, or in memory.

    Attributes
    ----------
    dof : int
        Number of joints.
    angle_rad, current_a : ndarray, shape (dof,)
        The last valid measurement, overwritten in place.
    alert : int
        Alert bits of all servos, or-ed; see `firmware_py.bus.registers.describe_alert`.
    late_ns : int
        Time by which the last measurement is later than the start of its read, because
        the second attempt made it; 0 where the first did, and after a read that failed.
    wait_ns : int
        Time spent waiting for the servos since the start.
    """

    dof: int
    angle_rad: Array
    current_a: Array
    alert: int

    @property
    def late_ns(self) -> int:
        """Time by which the last measurement is later than the start of its read."""
        ...

    @property
    def wait_ns(self) -> int:
        """Time spent waiting for the servos since the start."""
        ...

    def connect(self) -> None:
        """Check and prepare every servo, torque off.

        Raises
        ------
        InputError
            If a servo is unfit for the run.
        """
        ...

    def read(self, deadline_ns: int) -> BusStatus:
        """Measure angles and currents.

        Parameters
        ----------
        deadline_ns : int
            End of the wait for the answers, on the clock of the bus.
        """
        ...

    def write(self, goal_rad: Array, deadline_ns: int) -> BusStatus:
        """Send the goals.

        Parameters
        ----------
        goal_rad : ndarray, shape (dof,)
            Goal angles.
        deadline_ns : int
            End of the slot, on the clock of the bus.
        """
        ...

    def torque(self, on: bool) -> BusStatus:
        """Switch the torque of every servo; OK where every servo confirmed it."""
        ...

    def reopen(self) -> bool:
        """Open a port again that had gone; call `connect` before the servos are driven."""
        ...

    def close(self) -> None:
        """Switch the torque off if it may be on, and close the port; never raises."""
        ...
