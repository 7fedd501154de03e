"""The servos as the loop sees them: angles and currents in, goals out, faults as values.

A fault never raises inside the loop. `read` and `write` return a `BusStatus`; the arrays keep the
last good measurement, and the caller knows its age from the number of reads since.
`firmware_py.bus.dynamixel` speaks to real servos, `firmware_py.bus.loopback` stands in for them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class BusStatus(IntEnum):
    """Result of one exchange with the servos; from TIMEOUT on, the data is not fresh."""

    OK = 0
    RETRIED = 1
    """Fresh data, but only after the servos were asked a second time."""
    ALERT = 2
    """Fresh data, and at least one servo reports a hardware error, or does not drive though it
    should."""
    TIMEOUT = 3
    """A reply did not come before the deadline."""
    CORRUPT = 4
    """A reply came damaged."""
    REFUSED = 5
    """A servo answered that it could not follow the instruction."""
    PORT_GONE = 6
    """The device has disappeared."""

    @property
    def fresh(self) -> bool:
        """Whether the arrays hold what the servos just said."""
        return self <= BusStatus.ALERT


class ServoBus(Protocol):
    """What the loop drives: a real bus, or one in memory.

    Attributes
    ----------
    dof : int
        Number of joints.
    angle_rad, current_a : ndarray, shape (dof,)
        The last good measurement, overwritten in place.
    alert : int
        What the servos complain of, or-ed; see `firmware_py.bus.registers.describe_alert`.
    wait_ns : int
        Time spent waiting for the servos since the start.
    """

    dof: int
    angle_rad: Array
    current_a: Array
    alert: int

    @property
    def wait_ns(self) -> int:
        """Time spent waiting for the servos since the start."""
        ...

    def connect(self) -> None:
        """Check and prepare every servo, torque off; raise InputError where one is unfit."""
        ...

    def read(self, deadline_ns: int) -> BusStatus:
        """Measure angles and currents."""
        ...

    def write(self, goal_rad: Array, deadline_ns: int) -> BusStatus:
        """Send the goals, shape (dof,)."""
        ...

    def torque(self, on: bool) -> BusStatus:
        """Switch the torque of every servo."""
        ...

    def reopen(self) -> bool:
        """Open a port anew that was gone; `connect` must follow before the servos are driven."""
        ...

    def close(self) -> None:
        """Torque off if it is on, and let go of the port; never raises."""
        ...
