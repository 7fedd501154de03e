"""The error tree.

::

    DropstitchError                 anything that we raise on purpose
    ├── InputError                  the user's file, option or set-up is wrong (exit 2)
    ├── FmuRefusal                 an FMI unit refused a call; it stands where it stood
    └── SafetyTrip                  the supervisor stopped the robot; holds the last ticks (exit 1)

Inside the loop a fault is a value (`firmware_py.bus.servo_bus.BusStatus`), never an exception.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any


class DropstitchError(Exception):
    """Root of every error that this project raises on purpose."""


class InputError(DropstitchError):
    """Something that the user gave cannot be used.

    Parameters
    ----------
    where : str or Path
        File, option or device that is at fault.
    what : str
        What is wrong, naming the field (row, column, key) where there is one.
    remedy : str
        What the user can do about it, as an imperative.
    """

    def __init__(self, where: str | Path, what: str, remedy: str) -> None:
        self.where, self.what, self.remedy = str(where), what, remedy
        super().__init__(f"{where}: {what}; {remedy}.")

    def __reduce__(self) -> tuple[Any, ...]:
        """Let the error cross from a worker process to the command that shows it."""
        return type(self), (self.where, self.what, self.remedy)


class FmuRefusal(DropstitchError):
    """An FMI unit refused a call; the message is the sentence that it logged."""


class SafetyTrip(DropstitchError):
    """The safety supervisor stopped the robot.

    Parameters
    ----------
    reason : str
        One sentence: which limit, which joint, which value.
    last_ticks : Any
        The ticks that led here, a structured array of `firmware_py.signals.tick_dtype`.
    """

    def __init__(self, reason: str, last_ticks: Any = None) -> None:
        super().__init__(reason)
        self.last_ticks = last_ticks
