"""Interface between loop and servos: angles and currents in, goals out, faults as values.

A fault never raises inside the loop. `read` and `write` return a `BusStatus`; the arrays hold the
last valid measurement, and the caller counts the reads since as its age.
`firmware_py.bus.dynamixel` implements the interface.
"""

from __future__ import annotations

from enum import IntEnum, unique
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["BusStatus", "ServoBus"]

Array = NDArray[np.float64]


@unique
class BusStatus(IntEnum):
    """Result of one exchange with the servos; from TIMEOUT on, the data is not fresh."""

    OK = 0
    RETRIED = 1
    """Fresh data, from the second read of the tick."""
    ALERT = 2
    """Fresh data; at least one servo reports a hardware error, or has lost its torque."""
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
    """Bus of the servos as the loop uses it, real or in memory; times are in ns on its clock."""

    dof: int
    angle_rad: Array  # (dof,), the last valid measurement, overwritten in place
    current_a: Array  # (dof,), the same
    alert: int  # Alert bits of all servos, or-ed; see `firmware_py.bus.registers.describe_alert`

    @property
    def late_ns(self) -> int:
        """Delay of the last measurement after the start of its read, if the retry delivered it.

        0 if the first attempt did, and after a read that failed.
        """
        ...

    @property
    def wait_ns(self) -> int:
        """Total time spent waiting for the servos."""
        ...

    def connect(self) -> None:
        """Check and prepare every servo, torque off; raises InputError if one is not fit."""
        ...

    def read(self, deadline_ns: int) -> BusStatus:
        """Measure angles and currents, waiting for the answers until the deadline at most."""
        ...

    def write(self, goal_rad: Array, deadline_ns: int) -> BusStatus:
        """Send the goals, shape (dof,), by the end of the slot; OK if sent, no servo confirms."""
        ...

    def torque(self, on: bool) -> BusStatus:
        """Switch the torque of every servo; OK if every servo confirmed it."""
        ...

    def reopen(self) -> bool:
        """Open a disconnected port again, if it is back; then call `connect` before driving."""
        ...

    def close(self) -> None:
        """Switch the torque off if it may be on, and close the port; never raises."""
        ...
