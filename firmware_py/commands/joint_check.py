"""Check by hand, torque off, that the servo of each joint is the one in robot.toml.

Nothing else detects exchanged ids: both servos answer, and the predicted tip is merely wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_bus import ServoBus
from firmware_py.core.errors import InputError
from firmware_py.core.units import ANGLE
from firmware_py.system.clock import Clock

__all__ = ["JointTurn", "turn_joints"]

Array = NDArray[np.float64]

LEAST_TURN_RAD: Final = 0.087
"""Smallest turn by hand: 5°, far beyond the play of a gear [assumed]."""
STILL_RAD: Final = 0.009
"""Largest change within `STILL_S` of a joint at rest [assumed]."""
STILL_S: Final = 1.0
PATIENCE_S: Final = 60.0
"""Timeout for the operator."""
_POLL_NS: Final = 50_000_000


class JointTurn(NamedTuple):
    """Joint to turn, and the joint whose angle changed."""

    joint: int  # Number of the requested joint, from 1
    found: int  # Number of the joint whose angle changed most
    change_rad: float

    def told(self, ids: Sequence[int]) -> str:
        """Return the result as a sentence."""
        change = ANGLE.text(self.change_rad)
        if self.found == self.joint:
            return (
                f"joint {self.joint} was turned: its angle changed by {change} "
                f"(servo {ids[self.joint - 1]})"
            )
        return (
            f"joint {self.joint} was turned, and the angle of joint {self.found} (servo "
            f"{ids[self.found - 1]}) changed by {change}: the servos are exchanged; correct the "
            "order of [[servos]]"
        )


def turn_joints(
    bus: ServoBus, clock: Clock, timeout_s: float, ask: Callable[[str], None]
) -> tuple[JointTurn, ...]:
    """Ask for a turn of each joint by hand, and measure which angle changes."""
    watch = _Watch(bus, clock, timeout_s)
    turns = []
    for joint in range(1, bus.dof + 1):
        start_rad = watch.still()
        ask(f"turn joint {joint} by hand, by {ANGLE.text(LEAST_TURN_RAD, 0)} or more, no other")
        change_rad = watch.turned(start_rad)
        found = int(np.argmax(np.abs(change_rad)))
        turns.append(JointTurn(joint, found + 1, float(change_rad[found])))
    return tuple(turns)


class _Watch:
    """Measurement of joints that the operator turns."""

    def __init__(self, bus: ServoBus, clock: Clock, timeout_s: float) -> None:
        self._bus, self._clock = bus, clock
        self._timeout_ns = round(timeout_s * 1e9)

    def _angles(self) -> Array | None:
        """Measure the angles; None if that fails."""
        self._clock.sleep_until(self._clock.now_ns() + _POLL_NS)
        status = self._bus.read(self._clock.now_ns() + self._timeout_ns)
        return self._bus.angle_rad.copy() if status.fresh else None

    def still(self) -> Array:
        """Wait until no joint moves; return the angles."""
        first, since_ns = None, self._clock.now_ns()
        deadline_ns = since_ns + round(PATIENCE_S * 1e9)
        while self._clock.now_ns() < deadline_ns:
            now = self._angles()
            if now is None:
                continue
            if first is None or np.abs(now - first).max() > STILL_RAD:
                first, since_ns = now, self._clock.now_ns()
            elif self._clock.now_ns() - since_ns >= STILL_S * 1e9:
                return now
        raise InputError(
            "doctor", f"found no second in which the joints stand still within {PATIENCE_S:g} s",
            "check cabling and power of the servos, hold the arm still and repeat",
        )  # fmt: skip

    def turned(self, start_rad: Array) -> Array:
        """Wait until a joint has turned; return the changes."""
        deadline_ns = self._clock.now_ns() + round(PATIENCE_S * 1e9)
        while self._clock.now_ns() < deadline_ns:
            now = self._angles()
            if now is not None and np.abs(now - start_rad).max() >= LEAST_TURN_RAD:
                return np.asarray(now - start_rad)
        raise InputError(
            "doctor", f"saw no joint turn by {ANGLE.text(LEAST_TURN_RAD, 0)} in {PATIENCE_S:g} s",
            "turn it further, or check that its servo is one of [[servos]]",
        )  # fmt: skip
