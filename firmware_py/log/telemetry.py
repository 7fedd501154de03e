"""Telemetry: hand-over of packed tick records to another process.

Writing a log in the tick delays it by up to 8–13.5 ms, in another thread by up to 30–63 ms. Sending
a record through a non-blocking socket to another process takes 50 µs (docs/sources.md, "Fixed-rate
loop"). A record that the socket does not accept at once is dropped and counted, so the loop never
waits.
"""

from __future__ import annotations

import socket


class Telemetry:
    """Receiver of complete tick records; this one discards them."""

    drops = 0  # Records that were not delivered
    logged: int | None = None  # Ticks in the complete log; None if unknown

    def put(self, record: memoryview) -> None:
        """Send one record; never blocks, never raises."""


class SocketTelemetry(Telemetry):
    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._send = end.send

    def put(self, record: memoryview) -> None:
        """Send one record, or count it as dropped if the recorder is behind or gone."""
        try:
            self._send(record, socket.MSG_NOSIGNAL)  # SIGPIPE would stop the robot
        except OSError:
            self.drops += 1
