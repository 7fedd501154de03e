"""Emulated line between a program and the emulated servos, and its three ports.

`Line` computes the time at which each byte leaves the USB adapter, from its inputs alone; it reads
no clock. `VirtualTransport` runs it on a simulated clock: deterministic, faster than real time.
`serve_line` runs it in real time on a file descriptor: that of `pty_endpoint` for any Dynamixel
program, that of `socket_endpoint` for timing claims, because a pseudo-terminal passes through a
kernel worker that SCHED_FIFO readers starve (docs/sources.md, "Dynamixel SDK").

::

    host ─ transmission ─▶ servo ─ return delay ─ transmission ─▶ adapter ─ latency ─▶ host
"""

from __future__ import annotations

import contextlib
import heapq
import os
import select
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.bus.bus_plan import BITS_PER_BYTE
from firmware_py.bus.codec import PacketSearch
from firmware_py.core.errors import InputError
from firmware_py.system.clock import SimClock
from hil.emulator.emulated_bus import EmulatedBus
from hil.emulator.line_faults import FaultPlan

if sys.platform != "win32":  # --help works there
    import tty

USB_PACKET_BYTES: Final = 62
"""Bytes after which an FTDI adapter sends without waiting for its latency timer (AN232B-04)."""
_IDLE_S: Final = 0.05
_READ_SIZE: Final = 4096
_NO_FAULTS: Final = FaultPlan()


class _Arrival(NamedTuple):
    """Bytes that reach the adapter one after the other, from `start_ns` on."""

    start_ns: int
    data: bytes
    byte_ns: int


class Line:
    """Half-duplex line with a USB adapter at the host's end.

    The host sends at the baud rate of the first servo. `latency_s` is the period of the adapter's
    latency timer; 0 passes every byte on at once. Faults are injected only while a servo's torque
    is on: they are meant for the running loop, not for its start.
    """

    def __init__(self, bus: EmulatedBus, latency_s: float = 1e-3, faults: FaultPlan | None = None):
        self.bus = bus
        self.faults = faults or FaultPlan()
        self._latency_ns = round(latency_s * 1e9)
        self._timer_ns = 0
        self._free_ns = 0
        self._search = PacketSearch(host=False)

    def resume(self, now_ns: int) -> None:
        """Begin with another program at `now_ns`: what the last one left unfinished is dropped."""
        self._search.pending = b""
        self.bus.resume(now_ns)

    def receive(self, now_ns: int, data: bytes) -> list[tuple[int, bytes]]:
        """Transmit bytes of the host and the replies to them.

        Returns the replies' bytes, each with the time in ns at which the host can read them.
        """
        heard_ns = max(now_ns, self._free_ns) + len(data) * _byte_ns(self.bus.servos[0].baud)
        self._free_ns = heard_ns
        arrivals: list[_Arrival] = []
        for packet in self._search.feed(data):
            faults = self.faults if self.bus.driven else _NO_FAULTS
            if faults.loses(packet):
                continue
            for reply in self.bus.execute(packet, heard_ns):
                self._free_ns += reply.servo.return_delay_ns
                byte_ns = _byte_ns(reply.servo.baud)
                for delay_ns, damaged in faults.apply(reply.frame):
                    arrivals.append(_Arrival(self._free_ns + delay_ns, damaged, byte_ns))
                self._free_ns += len(reply.frame) * byte_ns
        return self._adapter(sorted(arrivals))

    def _adapter(self, arrivals: list[_Arrival]) -> list[tuple[int, bytes]]:
        """Hold bytes back until there are 62 or the free-running latency timer expires."""
        if self._latency_ns == 0:
            return [(start + len(data) * byte_ns, data) for start, data, byte_ns in arrivals]
        releases: list[tuple[int, bytes]] = []
        held, tick_ns = b"", 0
        for start_ns, data, byte_ns in arrivals:
            if held and tick_ns <= start_ns:
                releases.append((tick_ns, held))
                held = b""
            while len(held) + len(data) >= USB_PACKET_BYTES:
                room = USB_PACKET_BYTES - len(held)
                start_ns += room * byte_ns
                releases.append((start_ns, held + data[:room]))
                held, data, self._timer_ns = b"", data[room:], start_ns
            held += data
            tick_ns = self._next_tick_ns(start_ns + len(data) * byte_ns)
        if held:
            releases.append((tick_ns, held))
        return releases

    def _next_tick_ns(self, time_ns: int) -> int:
        self._timer_ns += -(-(time_ns - self._timer_ns) // self._latency_ns) * self._latency_ns
        return self._timer_ns


def _byte_ns(baud: int) -> int:
    return round(BITS_PER_BYTE * 1e9 / baud)


class VirtualTransport:
    """Transport in memory on a simulated clock (see `firmware_py.bus.transport.Transport`).

    The loop shares the clock; waiting for a reply advances it.
    """

    def __init__(self, line: Line, clock: SimClock) -> None:
        self._line, self._clock = line, clock
        self._pending: list[tuple[int, int, bytes]] = []
        self._count = 0

    def write(self, data: bytes) -> int:
        """Pass the bytes to the line; its replies become readable at their times."""
        for time_ns, answer in self._line.receive(self._clock.now_ns(), data):
            self._count += 1
            heapq.heappush(self._pending, (time_ns, self._count, answer))
        return len(data)

    def read(self, size: int, deadline_ns: int) -> bytes:
        """Return the first bytes readable before the deadline; the clock advances to their time."""
        if not self._pending or self._pending[0][0] > deadline_ns:
            self._clock.sleep_until(deadline_ns)
            return b""
        self._clock.sleep_until(self._pending[0][0])
        time_ns, count, data = heapq.heappop(self._pending)
        if len(data) > size:
            heapq.heappush(self._pending, (time_ns, count, data[size:]))
        return data[:size]

    def discard_input(self) -> None:
        """Drop the bytes that are readable now."""
        while self._pending and self._pending[0][0] <= self._clock.now_ns():
            heapq.heappop(self._pending)

    def close(self) -> None:
        self._pending.clear()


@contextlib.contextmanager
def pty_endpoint() -> Iterator[tuple[str, Callable[[], int | None]]]:
    """Open a pseudo-terminal; yield its name and a function that returns the descriptor to serve.

    Programs close and reopen the port when they set the baud rate. The slave descriptor stays open
    here, so that the line does not hang up meanwhile.
    """
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        yield os.ttyname(slave), lambda: master
    finally:
        os.close(master)
        os.close(slave)


@contextlib.contextmanager
def socket_endpoint(path: Path, stop_fd: int) -> Iterator[tuple[str, Callable[[], int | None]]]:
    """Open a UNIX stream socket; yield its name and a function that waits for a program.

    The function returns the connection's descriptor, or None if `stop_fd` becomes readable first.
    """
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(str(path))
        listener.listen(1)
    except OSError as error:
        listener.close()
        raise InputError(
            f"--path {path}", f"cannot be opened ({error.strerror or error})",
            "name a path in an existing directory of your own, of at most 107 bytes",
        ) from None  # fmt: skip
    connections: list[socket.socket] = []

    def accept() -> int | None:
        ready, _, _ = select.select([listener.fileno(), stop_fd], [], [])
        if listener.fileno() not in ready:
            return None
        connections.append(listener.accept()[0])
        return connections[-1].fileno()

    try:
        yield f"unix:{path}", accept
    finally:
        for connection in (*connections, listener):
            connection.close()
        path.unlink(missing_ok=True)


def serve_line(
    line: Line, fd: int, stop_fd: int, on_release: Callable[[int, int], None] | None = None
) -> bool:
    """Run the line in real time on a descriptor; the plant's time continues from now.

    `on_release` is called with the times at which bytes were due and were written. Returns True if
    the host hung up, False if `stop_fd` became readable.
    """
    pending: list[tuple[int, int, bytes]] = []
    count = 0
    line.resume(time.monotonic_ns())
    while True:
        now_ns = time.monotonic_ns()
        if pending and pending[0][0] <= now_ns:
            due_ns, _, data = heapq.heappop(pending)
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                os.write(fd, data)
            if on_release:
                on_release(due_ns, time.monotonic_ns())
            continue
        timeout_s = (pending[0][0] - now_ns) * 1e-9 if pending else _IDLE_S
        ready, _, _ = select.select([fd, stop_fd], [], [], timeout_s)
        if stop_fd in ready:
            return False
        if fd in ready:
            received_ns = time.monotonic_ns()
            try:
                data = os.read(fd, _READ_SIZE)
            except ConnectionResetError:
                data = b""
            if not data:
                return True
            for due_ns, answer in line.receive(received_ns, data):
                count += 1
                heapq.heappush(pending, (due_ns, count, answer))
        elif not pending:
            line.bus.advance(time.monotonic_ns())  # so that no backlog builds up in a long pause
