"""Tell systemd how the loop is: started, alive, stopping (the protocol of sd_notify(3)).

A datagram to the socket that the environment names is all there is to it, so no library is
needed. The loop says that it is alive from its log stage; if it ever hangs, systemd ends it and
runs `dropstitch release` (see the unit that `dropstitch install-service` writes).
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping
from typing import Final, Protocol

from firmware_py.realtime.clock import Clock

_SIGNS_PER_TIMEOUT: Final = 4


class Service(Protocol):
    """Whoever watches over the process."""

    def alive(self) -> None:
        """Say that the loop goes on; never blocks, never raises."""


class NoService:
    """Nobody watches."""

    def alive(self) -> None:
        """Do nothing."""


class SystemdService:
    """Notifies systemd; does nothing where it has not asked for that.

    Parameters
    ----------
    clock : Clock
        Tells when the next sign of life is due, four in the time that systemd waits for one.
    environment : mapping of str to str, optional
        With NOTIFY_SOCKET and WATCHDOG_USEC; by default the process's own.
    """

    def __init__(self, clock: Clock, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        if address[:1] in ("/", "@"):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
        self._address = address.replace("@", "\0", 1) if address[:1] == "@" else address
        self._interval_ns = int(environment.get("WATCHDOG_USEC", 0)) * 1000 // _SIGNS_PER_TIMEOUT
        self._now_ns, self._due_ns = clock.now_ns, 0
        self._started = False

    def alive(self) -> None:
        """Say READY the first time, then now and then that the loop is alive."""
        if self._socket is None or (self._started and not self._interval_ns):
            return
        now_ns = self._now_ns()
        if self._started and now_ns < self._due_ns:
            return
        self._due_ns = now_ns + self._interval_ns
        self._say(b"WATCHDOG=1" if self._started else b"READY=1")
        self._started = True

    def close(self) -> None:
        """Say that the loop has ended; the recorder may take a while longer."""
        if self._socket is not None:
            self._say(b"STOPPING=1")
            self._socket.close()
            self._socket = None

    def _say(self, message: bytes) -> None:
        assert self._socket is not None
        with contextlib.suppress(OSError):  # a full queue: the next sign will do
            self._socket.sendto(message, self._address)
