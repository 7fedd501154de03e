"""Byte streams to the servos: serial device or UNIX socket."""

from __future__ import annotations

import array
import contextlib
import glob
import os
import select
import socket
import sys
from pathlib import Path
from typing import Final, Protocol

import serial

from firmware_py.core.errors import InputError
from firmware_py.system.clock import Clock

_OPENING_ERRORS: tuple[type[Exception], ...] = (OSError, ValueError)
if sys.platform != "win32":  # Windows reads configurations, too
    import fcntl
    import termios

    _OPENING_ERRORS += (termios.error,)  # of a device that vanishes meanwhile; no OSError

BAUD_RATES: Final = (
    9600, 57_600, 115_200, 230_400, 460_800, 500_000, 576_000, 921_600, 1_000_000, 1_152_000,
    2_000_000, 2_500_000, 3_000_000, 3_500_000, 4_000_000,
)  # fmt: skip
"""Baud rates that servos or adapters offer."""

_DISCARD_SIZE: Final = 1 << 16
_MOST_DISCARDS: Final = 8
"""Reads of one discard: 512 kB, more than the 208 kB that a socket holds by default. The search for
the answer drops later bytes."""
_LONGEST_WAIT_NS: Final = 1_000_000_000
"""Upper bound on a wait, in case the clock is set back."""
_HUNG_UP: Final = "the other end has closed the connection"
_TIOCGSERIAL, _TIOCSSERIAL, _ASYNC_LOW_LATENCY = 0x541E, 0x541F, 1 << 13


class Transport(Protocol):
    """Byte stream to and from the servos; every method but `close` raises OSError if it is gone."""

    def read(self, size: int, deadline_ns: int) -> bytes:
        """Return up to `size` bytes as soon as any arrive, or none after the deadline."""
        ...

    def write(self, data: bytes) -> int:
        """Send bytes without waiting; return how many the device accepted."""
        ...

    def discard_input(self) -> None:
        """Drop the bytes received so far; this ends even if bytes keep arriving."""
        ...

    def close(self) -> None:
        """Close the device."""
        ...


class SerialTransport:
    """Serial device or pseudo-terminal."""

    def __init__(self, path: str, baud: int, clock: Clock) -> None:
        try:
            self._serial = serial.Serial(path, baud, timeout=0, exclusive=True)
        except _OPENING_ERRORS as error:
            raise InputError(
                path or "port", f"cannot be opened ({error})", _port_remedy(path)
            ) from None
        self._clock = clock
        self._fd: int = self._serial.fileno()
        self._request_low_latency()

    def _request_low_latency(self) -> None:
        """Ask the USB adapter to pass bytes on at once, if it knows how and permits it."""
        settings = array.array("i", [0] * 32)
        with contextlib.suppress(OSError):  # ENOTTY on a pseudo-terminal, EPERM without permission
            fcntl.ioctl(self._fd, _TIOCGSERIAL, settings)
            settings[4] |= _ASYNC_LOW_LATENCY
            fcntl.ioctl(self._fd, _TIOCSSERIAL, settings)

    def read(self, size: int, deadline_ns: int) -> bytes:
        if not _readable(self._fd, deadline_ns, self._clock):
            return b""
        if data := os.read(self._fd, size):
            return data
        raise ConnectionResetError(_HUNG_UP)  # readable without data means closed

    def write(self, data: bytes) -> int:
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0

    def discard_input(self) -> None:
        try:
            termios.tcflush(self._fd, termios.TCIFLUSH)
        except termios.error as error:  # not a subclass of OSError
            raise ConnectionResetError(_HUNG_UP) from error

    def close(self) -> None:
        self._serial.close()


class SocketTransport:
    """UNIX stream socket of an emulator; less jitter than a pseudo-terminal."""

    def __init__(self, path: str, clock: Clock) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(path)
        except OSError as error:
            self._socket.close()
            raise InputError(
                f"unix:{path}", f"cannot be connected to ({error.strerror or error})",
                "start the emulator with 'dropstitch emulate --line socket'",
            ) from None  # fmt: skip
        self._socket.setblocking(False)
        self._clock = clock
        self._fd = self._socket.fileno()

    def read(self, size: int, deadline_ns: int) -> bytes:
        return self._received(size) if _readable(self._fd, deadline_ns, self._clock) else b""

    def _received(self, size: int) -> bytes:
        data = self._socket.recv(size)
        if not data:
            raise ConnectionResetError(_HUNG_UP)
        return data

    def write(self, data: bytes) -> int:
        try:
            return self._socket.send(data, socket.MSG_NOSIGNAL)  # SIGPIPE would stop the robot
        except BlockingIOError:
            return 0

    def discard_input(self) -> None:
        for _ in range(_MOST_DISCARDS):
            if not _readable(self._fd, 0, self._clock):
                return
            self._received(_DISCARD_SIZE)

    def close(self) -> None:
        self._socket.close()


def _readable(fd: int, deadline_ns: int, clock: Clock) -> bool:
    """Wait until bytes are readable; after the deadline, check once without waiting.

    Polling first is cheaper than a failed read: in the loop the first answer never is there yet.
    """
    remaining_ns = max(0, min(deadline_ns - clock.now_ns(), _LONGEST_WAIT_NS))
    return bool(select.select([fd], [], [], remaining_ns * 1e-9)[0])


def open_transport(name: str, baud: int, clock: Clock) -> Transport:
    """Open the transport of a port.

    `name`: `unix:PATH` of a socket, or the path of a serial device. With wildcards, the first in
    alphabetical order that opens, because an adapter may come back under another name.
    """
    scheme = "unix:" if name.startswith("unix:") else ""
    pattern = name.removeprefix(scheme)
    refusals: list[InputError] = []
    for path in sorted(glob.glob(pattern)) or [pattern]:
        try:
            return SocketTransport(path, clock) if scheme else SerialTransport(path, baud, clock)
        except InputError as error:
            refusals.append(error)
    raise refusals[0]


def _port_remedy(path: str) -> str:
    if not path or not Path(path).exists():
        return "plug in the adapter and name its device (ls /dev/serial/by-id)"
    if not os.access(path, os.R_OK | os.W_OK):
        return "add yourself to the group dialout, or run 'dropstitch install-service'"
    return "close the program that uses it, and choose a baud rate that the adapter offers"
