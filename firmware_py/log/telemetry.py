"""The way of a tick out of the loop: one packed record to another process, or to nobody.

Logging inside the loop would cost it 8–13.5 ms at worst, in a thread beside it 30–63 ms; a record
through a non-blocking socket to another process costs 50 µs (docs/sources.md, "Fixed-rate loop"). A
record that does not fit at once is dropped and counted: the loop waits for nobody.
"""

from __future__ import annotations

import socket
from typing import Protocol


class Telemetry(Protocol):
    """Takes finished tick records.

    Attributes
    ----------
    drops : int
        Records that nobody got.
    """

    drops: int

    def put(self, record: memoryview) -> None:
        """Take the bytes of one record; never blocks, never raises."""
        ...


class NoTelemetry:
    """Takes records and forgets them."""

    drops = 0

    def put(self, record: memoryview) -> None:
        """Do nothing."""


class SocketTelemetry:
    """Sends records over a SEQPACKET socket.

    Parameters
    ----------
    end : socket
        The loop's end of a connected `AF_UNIX`, `SOCK_SEQPACKET` pair.
    """

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._send = end.send
        self.drops = 0

    def put(self, record: memoryview) -> None:
        """Send one record, or count it as dropped (the recorder is behind, or gone)."""
        try:
            self._send(record)
        except OSError:
            self.drops += 1
