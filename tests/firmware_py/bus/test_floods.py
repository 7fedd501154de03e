"""Floods: bytes that keep coming end an exchange at its deadline, a discard after some reads."""

import itertools
import socket

import pytest

from firmware_py.bus import codec
from firmware_py.bus import transport as transport_module
from firmware_py.bus.port import EXCHANGE_BYTES
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.transport import SocketTransport
from firmware_py.system.clock import DeadlineClock
from tests.firmware_py.bus.tampered import BUDGET_NS, LEGACY, PRO_A, SYNC_READ, make, read

FLOODS = {
    "zeros": bytes(64),
    "half a header": b"\xff\xff\xfd",
    "headers of long packets": b"\xff\xff\xfd\x00\x01\xf0\x03\x55",
    "packets with a wrong CRC": codec.build_status(1, 0, b"\1\2\3")[:-1] + b"\x00",
    "packets of another servo": codec.build_status(77, 0, b"\1\2\3"),
    "packets of an earlier tick": codec.build_status(1, 0, bytes(40)),
    "fast packets of an earlier tick": codec.build_status(0xFE, 0, bytes(40)),
}
PACES_NS = (0, 2_500)
"""Time that a byte takes: none at all, or that of the fastest line."""


class Flood:
    """What comes in place of every answer: bytes without an end."""

    def __init__(self, transport, clock, pattern, pace_ns):
        self.stream = itertools.cycle(pattern)
        self.clock, self.pace_ns = clock, pace_ns
        self.bytes, self.reads, self.late_reads, self.deadline_ns = 0, 0, 0, None
        transport.read = self.read
        transport.discard_input = lambda: None

    def read(self, size, deadline_ns):
        self.reads += 1
        self.late_reads += self.clock.now_ns() >= deadline_ns
        self.bytes += size
        self.clock.advance(size * self.pace_ns)
        return bytes(itertools.islice(self.stream, size))


def flooded(pattern, pace_ns, number=PRO_A):
    bus, transport, clock = make(number, number)
    bus.connect()
    return bus, Flood(transport, clock, FLOODS[pattern], pace_ns), clock


@pytest.mark.parametrize("number", [LEGACY, PRO_A])
@pytest.mark.parametrize("pace_ns", PACES_NS)
@pytest.mark.parametrize("pattern", FLOODS)
def test_a_flood_ends_a_read_at_its_deadline_with_a_bounded_number_of_bytes(
    pattern, pace_ns, number
):
    bus, flood, clock = flooded(pattern, pace_ns, number)
    start_ns = clock.now_ns()
    assert not read(bus, clock).fresh
    exchanges = 2
    assert flood.bytes <= exchanges * EXCHANGE_BYTES
    assert flood.late_reads <= exchanges
    # One read that has begun in time, and one after the deadline.
    assert clock.now_ns() - start_ns <= BUDGET_NS + 2 * 1024 * pace_ns


@pytest.mark.parametrize("pattern", FLOODS)
def test_a_flood_ends_the_access_to_a_register(pattern):
    bus, flood, _ = flooded(pattern, 0)
    assert bus.torque(False) is BusStatus.TIMEOUT
    accesses, attempts = 4, 3
    assert flood.bytes <= accesses * attempts * EXCHANGE_BYTES


@pytest.mark.parametrize("pattern", FLOODS)
def test_a_flood_ends_a_read_where_the_clock_was_set_back(pattern):
    bus, flood, clock = flooded(pattern, 10)
    bus.read(clock.now_ns() + 3_600_000_000_000)
    assert flood.bytes <= 2 * EXCHANGE_BYTES


def test_an_answer_that_was_there_in_time_counts_after_the_deadline():
    bus, transport, clock = make(PRO_A, PRO_A)
    bus.connect()
    late_ns = BUDGET_NS + 1
    wait = transport.write

    def preempted(data):
        accepted = wait(data)
        if data[7] == SYNC_READ or data[7] == 0x8A:
            clock.advance(late_ns)
        return accepted

    transport.write = preempted
    assert read(bus, clock) is BusStatus.OK


def test_a_discard_ends_while_bytes_keep_coming(tmp_path, monkeypatch):
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "line"))
    listener.listen()
    transport = SocketTransport(str(tmp_path / "line"), DeadlineClock())
    other_end = listener.accept()[0]
    received, taken = SocketTransport._received, []

    def refilled(self, size):
        data = received(self, size)
        taken.append(len(data))
        assert len(taken) < 1000, "it never ends"
        other_end.sendall(b"x" * 100)
        return data

    monkeypatch.setattr(SocketTransport, "_received", refilled)
    other_end.sendall(b"x" * 100)
    transport.discard_input()
    assert len(taken) <= transport_module._MOST_DISCARDS
    for end in (other_end, listener, transport):
        end.close()
