"""Notification of systemd: started, alive, stopping (the protocol of sd_notify(3)).

The protocol is a datagram to the socket that the environment names. The loop notifies systemd from
its log stage. If it hangs, systemd ends it and runs `dropstitch release`, according to the service
file of `dropstitch install-service`.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping
from typing import Final

from firmware_py.system.clock import Clock

_NOTIFICATIONS: Final = 4
"""Number of notifications within the timeout of systemd."""


class Service:
    """Watchdog of the process; this one is none."""

    def alive(self) -> None:
        """Notify that the loop is running; never blocks, never raises."""


class SystemdService(Service):
    """Watchdog of systemd; it does nothing if the environment names no socket.

    `clock`: clock of the notifications; there are four within the timeout of systemd.
    `environment`: environment with NOTIFY_SOCKET and WATCHDOG_USEC; by default that of the process.
    """

    def __init__(self, clock: Clock, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        if address[:1] in ("/", "@"):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
        self._address = address.replace("@", "\0", 1) if address[:1] == "@" else address
        self._interval_ns = int(environment.get("WATCHDOG_USEC", 0)) * 1000 // _NOTIFICATIONS
        self._now_ns, self._due_ns = clock.now_ns, 0
        self._started = False

    def alive(self) -> None:
        """Notify READY the first time, afterwards WATCHDOG when it is due."""
        if self._socket is None or (self._started and not self._interval_ns):
            return
        now_ns = self._now_ns()
        if self._started and now_ns < self._due_ns:
            return
        self._due_ns = now_ns + self._interval_ns
        self._notify(self._socket, b"WATCHDOG=1" if self._started else b"READY=1")
        self._started = True

    def close(self) -> None:
        """Notify that the loop has ended; the recorder may still be writing."""
        if self._socket is not None:
            self._notify(self._socket, b"STOPPING=1")
            self._socket.close()
            self._socket = None

    def _notify(self, end: socket.socket, message: bytes) -> None:
        with contextlib.suppress(OSError):  # queue full: the next notification is enough
            end.sendto(message, self._address)
