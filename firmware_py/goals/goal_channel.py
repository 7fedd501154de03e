"""Channel to the program that sends goals: its messages, and the socket that carries them.

In every tick the robot sends a `StatusMessage`; the program answers with a `GoalMessage`, one JSON
object each (docs/tip/goals.md). The Unix socket preserves message boundaries: `SOCK_SEQPACKET`
delivers whole messages in order and reports at once that the other side has closed. The robot
listens, accepts one program, and never waits for it in a tick.
"""

from __future__ import annotations

import contextlib
import math
import socket
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Protocol

import msgspec

from firmware_py.core.errors import InputError

MOST_BYTES: Final = 512
"""Length of the longest message that is read [assumed]; a message for two joints has 70."""


class GoalMessage(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Goals from a program: exactly one of `joint_rad`, `tip_m` and `end`."""

    tick: int  # `tick` of the status message that it answers
    joint_rad: tuple[float, ...] | None = None
    # Position of the tip in the world frame: x, and y with two joints
    tip_m: tuple[float, ...] | None = None
    end: bool = False  # Whether to end the run without a fault


class StatusMessage(msgspec.Struct, frozen=True):
    tick: int
    time_s: float  # Time since the start of the motion
    state: str  # State of the safety supervisor
    goal_rad: tuple[float, ...]  # Goals sent, one per joint
    angle_rad: tuple[float, ...]  # Measured angles, one per joint
    tip_m: tuple[float, ...]  # Predicted tip, x, y and z in the world frame
    in_range: bool  # Whether the inputs of the predictor are in its training range
    payload_kg: float | None  # Estimated mass at the tip; None if it is not estimated
    reason: str = ""  # Reason of the stop; empty before


_DECODER: Final = msgspec.json.Decoder(GoalMessage)
_ENCODER: Final = msgspec.json.Encoder()


def decode_goal(data: bytes, dof: int) -> GoalMessage | str:
    """Return the goals of a message, or a description of its error."""
    if len(data) > MOST_BYTES:
        return f"has more than {MOST_BYTES} bytes"
    try:
        goal = _DECODER.decode(data)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return f"cannot be read ({error})"
    if (goal.joint_rad is not None) + (goal.tip_m is not None) + goal.end != 1:
        return "needs one of joint_rad, tip_m and end"
    values = goal.joint_rad or goal.tip_m or ()
    if not goal.end and len(values) != dof:
        return f"has {len(values)} values for {dof} joints"
    if not all(map(math.isfinite, values)):
        return "has a value that is not finite"
    return goal


def encode_goal(goal: GoalMessage) -> bytes:
    return _ENCODER.encode(goal)


def encode_status(status: StatusMessage) -> bytes:
    """Return the message of a status; NaN becomes null."""
    return _ENCODER.encode(status)


PREFIX: Final = "unix:"


class GoalChannel(Protocol):
    """Interface of a channel to and from a program."""

    gone: bool  # Whether the program has closed its side

    def receive(self, most: int) -> list[bytes]: ...

    def send(self, data: bytes) -> None:
        """Send a message, which is dropped if the program does not read."""
        ...


class SocketChannel:
    """Channel over a connected `SOCK_SEQPACKET` socket, which it closes.

    `patience_s`: timeout for the answer to the latest status; 0 never waits. It is for simulated
    time only, which stands still while the program computes.
    """

    def __init__(self, connection: socket.socket, patience_s: float = 0.0) -> None:
        self.gone = False
        self._connection, self._patience_s = connection, patience_s
        self._asked = False
        connection.setblocking(False)

    def receive(self, most: int) -> list[bytes]:
        messages: list[bytes] = []
        if self._asked and self._patience_s and not self.gone:
            self._connection.settimeout(self._patience_s)
            self._take(messages)
            self._connection.setblocking(False)
            self._asked = False
        while len(messages) < most and not self.gone and self._take(messages):
            pass
        return messages

    def _take(self, messages: list[bytes]) -> bool:
        try:
            data = self._connection.recv(MOST_BYTES + 1)
        except (BlockingIOError, TimeoutError):
            return False
        except OSError:
            data = b""
        if data:
            messages.append(data)
        else:
            self.gone = True
        return bool(data)

    def send(self, data: bytes) -> None:
        try:
            self._connection.send(data)
            self._asked = True
        except BlockingIOError:
            pass
        except OSError:
            self.gone = True

    def close(self) -> None:
        self._connection.close()


@contextlib.contextmanager
def accepted_program(
    address: str, wait_s: float, patience_s: float = 0.0
) -> Iterator[SocketChannel]:
    """Listen, and yield the channel of the first program that connects; refuse any other.

    `address`: `unix:PATH`; only the owner of the robot's process may connect.
    """
    path = _path_of(address)
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) as listener:
        try:
            _remove_old(path)
            listener.bind(str(path))
            path.chmod(0o600)
            listener.listen(1)
        except OSError as error:
            raise InputError(
                "--goals", f"{address} cannot be opened ({error.strerror or error})",
                "name a path in a directory of your own",
            ) from None  # fmt: skip
        try:
            print(f"waiting at {address} for the program that sends the goals", file=sys.stderr)
            listener.settimeout(wait_s)
            connection = listener.accept()[0]
        except TimeoutError:
            raise InputError(
                "--goals", f"no program connected to {address} within {wait_s:g} s",
                "start the program that sends the goals",
            ) from None  # fmt: skip
        finally:
            listener.close()
            path.unlink(missing_ok=True)
    with contextlib.closing(SocketChannel(connection, patience_s)) as channel:
        yield channel


def connect(address: str) -> socket.socket:
    """Connect a Python program to a robot that listens for goals."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        connection.connect(str(_path_of(address)))
    except OSError as error:
        connection.close()
        raise InputError(
            address, f"no robot listens there ({error.strerror})", "start dropstitch run --goals"
        ) from None
    return connection


def _path_of(address: str) -> Path:
    if not address.startswith(PREFIX) or len(address) == len(PREFIX):
        raise InputError("--goals", f"is {address!r}", f"give {PREFIX}PATH")
    return Path(address.removeprefix(PREFIX))


def _remove_old(path: Path) -> None:
    """Remove a socket that nobody listens on; with a listener it stays, and `bind` fails."""
    if not path.exists() or not stat.S_ISSOCK(path.stat().st_mode):
        return
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink(missing_ok=True)
