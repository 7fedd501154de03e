"""Faults of line and servos in a read, against servos in memory with tampered answers."""

import itertools
import socket

import numpy as np
import pytest

from firmware_py.bus import codec
from firmware_py.bus import transport as transport_module
from firmware_py.bus.port import EXCHANGE_BYTES
from firmware_py.bus.registers import STOPPED_BY_WATCHDOG, TORQUE_LOST, Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.transport import SocketTransport
from firmware_py.system.clock import DeadlineClock
from tests.firmware_py.bus.tampered import (
    BUDGET_NS,
    EXCHANGE_NS,
    LEGACY,
    MARGIN_NS,
    PRO_A,
    SYNC_READ,
    flip_payload,
    make,
    paced,
    read,
    with_error,
)


@pytest.mark.parametrize(
    ("tamper", "expected"),
    [
        (lambda data: b"", BusStatus.TIMEOUT),
        (lambda data: data[: len(data) // 2], None),
        (flip_payload, BusStatus.CORRUPT),
        (lambda data: data[:-3], BusStatus.CORRUPT),
    ],
)
def test_a_bad_answer_is_a_status_and_leaves_the_last_good_data(pair, tamper, expected):
    bus, transport, clock = pair
    bus.write(np.array([0.3, 0.4]), clock.now_ns() + BUDGET_NS)
    assert read(bus, clock) is BusStatus.OK
    before = bus.angle_rad.copy()
    assert before.all(), "zeros would hide the zeros that the SDK returns"
    bus.write(np.array([0.1, 0.2]), clock.now_ns() + BUDGET_NS)
    transport.tamper = tamper
    if expected is None:  # half of a common packet, or the first of two
        expected = BusStatus.CORRUPT if bus.plan.fast else BusStatus.TIMEOUT
    start_ns = clock.now_ns()
    assert read(bus, clock) is expected
    assert clock.now_ns() - start_ns <= BUDGET_NS
    assert bus.angle_rad.tolist() == before.tolist()
    transport.tamper = lambda data: data
    assert read(bus, clock) is BusStatus.OK
    assert bus.angle_rad[0] == pytest.approx(0.1, abs=1e-3)


def test_answers_in_any_order_doubled_or_from_a_stranger_are_sorted_out():
    bus, transport, clock = make(LEGACY, LEGACY)
    bus.connect()
    bus.write(np.array([0.1, 0.2]), clock.now_ns() + BUDGET_NS)
    size = bus.plan.block.size
    strange, each = codec.build_status(3, 0, bytes(size)), codec.STATUS_OVERHEAD + size
    transport.tamper = lambda data: strange + data[each:] + data[each:] + data[:each]
    assert read(bus, clock) is BusStatus.OK
    assert bus.angle_rad == pytest.approx([0.1, 0.2], abs=1e-4)


def test_an_alert_lasts_and_its_cause_is_read_once():
    bus, transport, clock = make(LEGACY, LEGACY)
    bus.connect()
    transport.put(2, Register.HARDWARE_ERROR, 0b100000)
    size = codec.STATUS_OVERHEAD + bus.plan.block.size
    transport.tamper = lambda data: (
        data[:size] + with_error(data[size:], 0x80) if len(data) == 2 * size else data
    )
    assert read(bus, clock) is BusStatus.ALERT
    assert BusStatus.ALERT.fresh
    assert bus.alert == 0b100000
    sent = len(transport.written)
    assert read(bus, clock) is BusStatus.ALERT
    assert len(transport.written) == sent + 1


@pytest.mark.parametrize("late_by", [1, 3])
def test_the_answer_to_an_earlier_read_is_never_taken_for_this_one(pair, late_by):
    """It arrives behind the next instruction, whole and undamaged, in front of the real one."""
    bus, transport, clock = pair
    late = []
    transport.tamper = lambda data: late.append(data) or b""
    for k in range(late_by):
        bus.write(np.full(2, 0.1 * (k + 1)), clock.now_ns() + BUDGET_NS)
        assert read(bus, clock) is BusStatus.TIMEOUT
    transport.tamper = lambda data: b"".join(late) + data
    bus.write(np.full(2, 0.5), clock.now_ns() + BUDGET_NS)
    assert read(bus, clock) is BusStatus.OK
    assert bus.angle_rad == pytest.approx([0.5, 0.5], abs=1e-3)


@pytest.mark.parametrize(
    ("budget_ns", "expected"),
    [
        (8_000_000, BusStatus.RETRIED),
        (2 * EXCHANGE_NS + MARGIN_NS, BusStatus.RETRIED),
        (2 * EXCHANGE_NS + MARGIN_NS - 1, BusStatus.TIMEOUT),
    ],
)
def test_a_lost_answer_is_asked_for_again_where_both_reads_fit(budget_ns, expected):
    bus, transport, clock = paced()
    transport.fates, start_ns, sent = ("lost",), clock.now_ns(), len(transport.written)
    assert bus.read(start_ns + budget_ns) is expected
    again = expected is BusStatus.RETRIED
    assert len(transport.written) - sent == 1 + again
    taken_ns = budget_ns - MARGIN_NS if again else budget_ns
    assert clock.now_ns() - start_ns == taken_ns, "a single read has all the time"
    assert bus.late_ns == (taken_ns - EXCHANGE_NS if again else 0), "the second was sent then"
    assert (read(bus, clock), bus.late_ns) == (BusStatus.OK, 0)


@pytest.mark.parametrize(("short_ns", "again"), [(0, True), (1, False)])
def test_a_damaged_answer_is_asked_for_again_at_once_where_time_is_left(short_ns, again):
    bus, transport, clock = paced()
    transport.fates, start_ns, sent = ("damaged",), clock.now_ns(), len(transport.written)
    status = bus.read(start_ns + 2 * EXCHANGE_NS - short_ns)
    assert status is (BusStatus.RETRIED if again else BusStatus.CORRUPT)
    assert len(transport.written) - sent == 1 + again
    assert bus.late_ns == (EXCHANGE_NS if again else 0)
    transport.fates, sent = ("damaged",) * 3, len(transport.written)
    assert bus.read(clock.now_ns() + 100_000_000) is BusStatus.CORRUPT
    assert len(transport.written) - sent == 2, "a read is repeated once and no more"


def test_an_alert_in_the_second_read_stops_the_robot_all_the_same():
    bus, transport, clock = paced()
    transport.put(1, Register.HARDWARE_ERROR, 0b100)

    def alert(data):
        if len(data) < 30 or transport.fates:  # the answers of both servos
            return data
        return with_error(data[: len(data) // 2], 0x80) + data[len(data) // 2 :]

    transport.fates, transport.tamper = ("lost",), alert
    assert bus.read(clock.now_ns() + BUDGET_NS) is BusStatus.ALERT
    assert bus.alert == 0b100


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize(
    ("register", "raw", "number", "bits"),
    [(Register.TORQUE_ENABLE, 0, LEGACY, TORQUE_LOST),
     (Register.TORQUE_ENABLE, 0, PRO_A, TORQUE_LOST),
     (Register.BUS_WATCHDOG, -1, PRO_A, STOPPED_BY_WATCHDOG)],
)  # fmt: skip
def test_a_servo_that_does_not_drive_says_so_in_the_next_read(register, raw, number, bits, joint):
    bus, transport, clock = make(number, number)
    bus.connect()
    bus.torque(True)
    assert read(bus, clock) is BusStatus.OK
    transport.put(joint, register, raw)
    assert (read(bus, clock), bus.alert) == (BusStatus.ALERT, bits)
    assert len(transport.written[-1]) == len(transport.written[-2]), "nothing was asked besides"


def test_a_torque_that_was_never_switched_on_is_no_alert(pair):
    bus, transport, clock = pair
    assert (read(bus, clock), bus.alert) == (BusStatus.OK, 0)
    bus.torque(True)
    bus.torque(False)
    assert (read(bus, clock), bus.alert) == (BusStatus.OK, 0)
    transport.tamper = lambda data: b""
    bus.torque(True)  # no servo confirms
    transport.tamper = lambda data: data
    transport.put(1, Register.TORQUE_ENABLE, 0)
    assert (read(bus, clock), bus.alert) == (BusStatus.OK, 0)


# --- floods ---------------------------------------------------------------------------------------


FLOODS = {
    "zeros": bytes(64),
    "half a header": b"\xff\xff\xfd",
    "headers of long packets": b"\xff\xff\xfd\x00\x01\xf0\x03\x55",
    "packets with a wrong CRC": codec.build_status(1, 0, b"\1\2\3")[:-1] + b"\x00",
    "packets of another servo": codec.build_status(77, 0, b"\1\2\3"),
    "packets of an earlier tick": codec.build_status(1, 0, bytes(40)),
    "fast packets of an earlier tick": codec.build_status(0xFE, 0, bytes(40)),
}
HOUR_NS = 3_600_000_000_000


class Flood:
    """Bytes without an end instead of every answer."""

    def __init__(self, transport, clock, pattern, pace_ns):
        self.stream = itertools.cycle(FLOODS[pattern])
        self.clock, self.pace_ns = clock, pace_ns
        self.bytes, self.late_reads = 0, 0
        transport.read = self.read
        transport.discard_input = lambda: None

    def read(self, size, deadline_ns):
        self.late_reads += self.clock.now_ns() >= deadline_ns
        assert size <= 1024, "a long read would outlast the deadline"
        self.bytes += size
        self.clock.advance(size * self.pace_ns)
        return bytes(itertools.islice(self.stream, size))


def flooded(pattern, pace_ns, number=PRO_A):
    bus, transport, clock = make(number, number)
    bus.connect()
    return bus, Flood(transport, clock, pattern, pace_ns), clock


@pytest.mark.parametrize("number", [LEGACY, PRO_A])
@pytest.mark.parametrize("pace_ns", [0, 2_500], ids=["at once", "at the fastest line's pace"])
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
def test_a_flood_ends_torque_off_and_a_read_whose_clock_was_set_back(pattern):
    bus, flood, _ = flooded(pattern, 0)
    assert bus.torque(False) is BusStatus.TIMEOUT
    accesses, attempts = 4, 3
    assert flood.bytes <= accesses * attempts * EXCHANGE_BYTES
    bus, flood, clock = flooded(pattern, 10)
    bus.read(clock.now_ns() + HOUR_NS)
    assert flood.bytes <= 2 * EXCHANGE_BYTES


def test_an_answer_that_was_there_in_time_counts_after_the_deadline():
    bus, transport, clock = make(PRO_A, PRO_A)
    bus.connect()
    write = transport.write

    def preempted(data):
        accepted = write(data)
        if data[7] in (SYNC_READ, 0x8A):
            clock.advance(BUDGET_NS + 1)
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
