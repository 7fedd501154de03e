"""Errors that this project raises on purpose.

::

    DropstitchError                 root
    ├── InputError                  a file, an option or the set-up cannot be used (exit 2)
    ├── FmuRefusal                  an FMU refused a call; its state is unchanged
    └── SafetyTrip                  a fault stopped the robot; holds the last ticks (exit 1)

Inside the loop a fault is a value (`firmware_py.bus.servo_bus.BusStatus`), never an exception.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

_LONGEST: Final = 800
"""Longest part of a message in characters; the rest, from the content of a file, is cut."""


class DropstitchError(Exception):
    """Root of every error that this project raises on purpose.

    Examples
    --------
    >>> import dropstitch
    >>> try:
    ...     dropstitch.read_plant("no.toml")
    ... except dropstitch.DropstitchError as error:
    ...     print(error)
    no.toml: is missing; name a plant or a link.
    """


class InputError(DropstitchError):
    """A file, an option or a device that the user named cannot be used.

    Parameters
    ----------
    where : str or Path
        The file, option or device.
    what : str
        What is wrong, with the row, column or key.
    remedy : str
        What the user can do, as an imperative.

    Examples
    --------
    >>> print(InputError("robot.toml", "bus.baud is 9600", "choose 57600 or more"))
    robot.toml: bus.baud is 9600; choose 57600 or more.
    """

    def __init__(self, where: str | Path, what: str, remedy: str) -> None:
        self.where, self.what, self.remedy = map(_one_line, (str(where), what, remedy))
        super().__init__(f"{self.where}: {self.what}; {self.remedy}.")

    def __reduce__(self) -> tuple[Any, ...]:
        """Support pickling, so that the error passes from a worker process to the command."""
        return type(self), (self.where, self.what, self.remedy)


class FmuRefusal(DropstitchError):
    """An FMU refused a call; the message is the one that it logged."""


class SafetyTrip(DropstitchError):
    """A fault stopped the robot or occurred in the stop, or a torque off was not confirmed."""

    def __init__(self, reason: str, last_ticks: Any = None) -> None:
        super().__init__(reason)
        self.last_ticks = last_ticks


def _one_line(text: str) -> str:
    """Return text of a library or a file on one line, without terminal control characters."""
    line = " ".join(text[: 10 * _LONGEST].split())
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in line)
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} … {line[-_LONGEST // 4 :]}"
