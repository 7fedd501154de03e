"""Port under deadlines and packets, compared with the SDK as shipped."""

import os
import socket
import threading
import tty

import pytest
from dynamixel_sdk import Protocol2PacketHandler
from dynamixel_sdk.robotis_def import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.port import DeadlinePort, PacketHandler
from firmware_py.bus.transport import open_transport
from firmware_py.core.errors import InputError
from firmware_py.system.clock import DeadlineClock, SimClock

tricky = st.lists(st.sampled_from([0x00, 0x55, 0xFC, 0xFD, 0xFE, 0xFF]), max_size=40)


class TapeTransport:
    """Keeps what is written, plays what it was given; waiting moves the clock to the deadline."""

    def __init__(self, clock, *plays):
        self.clock, self.plays, self.written = clock, list(plays), []

    def read(self, size, deadline_ns):
        if not self.plays:
            self.clock.sleep_until(deadline_ns)
            return b""
        return self.plays.pop(0)

    def write(self, data):
        self.written.append(bytes(data))
        return len(data)

    def discard_input(self):
        pass

    def close(self):
        pass


def instruction(parameters, id_=1, code=3):
    length = len(parameters) + 3
    return [0, 0, 0, 0, id_, length & 0xFF, length >> 8, code, *parameters, 0, 0]


def sent(handler, parameters):
    transport = TapeTransport(SimClock())
    assert (
        handler.txPacket(DeadlinePort(transport, SimClock()), instruction(parameters))
        == COMM_SUCCESS
    )
    return transport.written[0]


def body(frame):
    """Instruction and parameters of a frame whose CRC is right, unstuffed by the letter."""
    assert (
        Protocol2PacketHandler().updateCRC(0, frame, len(frame) - 2) == frame[-2] | frame[-1] << 8
    )
    assert frame[5] | frame[6] << 8 == len(frame) - 7
    out, region = [], frame[7:-2]
    skip = False
    for k, byte in enumerate(region):
        if skip:
            assert byte == 0xFD, "a header inside the packet is not stuffed"
            skip = False
            continue
        out.append(byte)
        skip = region[max(0, k - 2) : k + 1] == b"\xff\xff\xfd"
    assert not skip, "the packet ends within a header"
    return out


@given(tricky)
def test_whatever_is_sent_arrives_and_holds_no_false_header(parameters):
    frame = sent(PacketHandler(), parameters)
    assert body(frame) == [3, *parameters]


@given(tricky)
def test_sdk_and_ours_send_the_same_where_nothing_needs_stuffing(parameters):
    if b"\xff\xff\xfd" not in bytes(parameters):
        assert sent(PacketHandler(), parameters) == sent(Protocol2PacketHandler(), parameters)


def test_sdk_as_shipped_sends_the_goal_minus_131073_as_a_false_header():
    goal = (-131073).to_bytes(4, "little", signed=True)
    assert goal == b"\xff\xff\xfd\xff"
    parameters = [596 & 0xFF, 596 >> 8, *goal]
    assert b"\xff\xff\xfd\xfd" not in sent(Protocol2PacketHandler(), parameters)
    assert b"\xff\xff\xfd\xfd\xff" in sent(PacketHandler(), parameters)


def status(data, id_=1):
    handler = PacketHandler()
    packet = handler.addStuffing(instruction([0, *data], id_, 0x55))
    packet[:4] = [0xFF, 0xFF, 0xFD, 0]
    crc = handler.updateCRC(0, packet, len(packet) - 2)
    packet[-2:] = [crc & 0xFF, crc >> 8]
    return bytes(packet)


def received(handler, frame):
    clock = SimClock()
    port = DeadlinePort(TapeTransport(clock, frame), clock)
    port.deadline_ns = 1
    packet, result = handler.rxPacket(port, False)
    assert result == COMM_SUCCESS
    return list(packet[9:-2])


@given(tricky)
def test_whatever_a_servo_sends_is_read_back(data):
    assert received(PacketHandler(), status(data)) == data


def test_sdk_as_shipped_loses_a_byte_after_a_stuffed_header():
    data = [0xFF, 0xFF, 0xFD, 0xFF, 0xFD, 0xFD]
    assert received(Protocol2PacketHandler(), status(data))[: len(data)] != data
    assert received(PacketHandler(), status(data)) == data


@given(st.binary(max_size=200))
def test_crc_is_that_of_the_sdk(data):
    ours, theirs = PacketHandler(), Protocol2PacketHandler()
    assert ours.updateCRC(0, data, len(data)) == theirs.updateCRC(0, data, len(data))


class ByteByByte(Protocol2PacketHandler):
    """The SDK's search for packets, on whose stuffing nothing hangs here."""

    def removeStuffing(self, packet):
        return packet


pieces = st.lists(
    st.one_of(
        st.lists(st.integers(0, 0xFC), max_size=20).map(status),
        st.builds(status, st.lists(st.integers(0, 0xFC), max_size=20), st.just(0xFE)),
        st.sampled_from([0x00, 0x55, 0xFD, 0xFE, 0xFF]).map(lambda byte: bytes([byte])),
        st.binary(max_size=30),
        st.just(b"\xff\xff\xfd\x00\x01"),
    ),
    max_size=8,
)


@given(pieces, st.booleans(), st.data())
def test_packets_are_found_where_the_sdk_finds_them(stream, fast, data):
    stream = bytearray(b"".join(stream))
    for _ in range(data.draw(st.integers(0, 3)) if stream else 0):  # damage
        stream[data.draw(st.integers(0, len(stream) - 1))] = data.draw(st.integers(0, 255))
    tapes = []
    for handler in (PacketHandler(), ByteByByte()):
        clock = SimClock()
        port = DeadlinePort(TapeTransport(clock, bytes(stream)), clock)
        port.deadline_ns = 1
        tape = []
        while not tape or (tape[-1][1] != COMM_RX_TIMEOUT and len(tape) < 20):
            packet, result = handler.rxPacket(port, fast)
            tape.append((bytes(packet) if result == COMM_SUCCESS else b"", result))
        tapes.append(tape)
    assert tapes[0] == tapes[1]


def test_the_packet_behind_one_of_length_zero_is_found():
    stream = bytearray(status([]) + status([]))
    stream[5] = 0
    for handler in (PacketHandler(), Protocol2PacketHandler()):
        clock = SimClock()
        port = DeadlinePort(TapeTransport(clock, bytes(stream)), clock)
        port.deadline_ns = 1
        assert [handler.rxPacket(port, False)[1] for _ in range(3)] == [
            COMM_RX_CORRUPT, COMM_SUCCESS, COMM_RX_TIMEOUT,
        ]  # fmt: skip


def test_a_reply_in_pieces_is_put_together():
    clock = SimClock()
    frame = status([1, 2, 3, 4])
    port = DeadlinePort(TapeTransport(clock, *(frame[k : k + 1] for k in range(len(frame)))), clock)
    port.deadline_ns = 1
    packet, result = PacketHandler().rxPacket(port, False)
    assert result == COMM_SUCCESS
    assert list(packet[9:13]) == [1, 2, 3, 4]


def test_a_lost_reply_costs_the_budget_and_not_a_nanosecond_more():
    clock = SimClock(5_000_000)
    port = DeadlinePort(TapeTransport(clock), clock)
    port.deadline_ns = 13_000_000
    port.setPacketTimeout(100)  # as the SDK does before each read: must not matter
    port.setPacketTimeoutMillis(800)
    _, result = PacketHandler().rxPacket(port, False)
    assert result == COMM_RX_TIMEOUT
    assert clock.now_ns() == 13_000_000
    assert port.wait_ns == 8_000_000


@pytest.fixture(params=["socket", "pty"])
def line(request, tmp_path):
    """A port name, and the descriptor at the other end of it."""
    if request.param == "pty":
        master, slave = os.openpty()
        tty.setraw(slave)
        yield os.ttyname(slave), lambda: master
        os.close(master)
        os.close(slave)
    else:
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(str(tmp_path / "line"))
        listener.listen()
        kept = []

        def accept():
            kept.append(listener.accept()[0])
            return kept[-1].fileno()

        yield f"unix:{tmp_path / 'line'}", accept
        for each in (*kept, listener):
            each.close()


def test_bytes_pass_through_a_real_transport_both_ways(line):
    name, other_end = line
    clock = DeadlineClock()
    transport = open_transport(name, 1_000_000, clock)
    fd = other_end()
    assert transport.write(b"\xff\x00\x0a\x0d\x11\x13") == 6
    assert os.read(fd, 100) == b"\xff\x00\x0a\x0d\x11\x13"
    answer = threading.Thread(target=os.write, args=(fd, b"\x03\x04\xfd"))
    answer.start()
    assert transport.read(100, clock.now_ns() + 5_000_000_000) == b"\x03\x04\xfd"
    answer.join()
    transport.close()


def test_a_silent_transport_gives_nothing_once_the_deadline_is_over(line):
    name, other_end = line
    clock = DeadlineClock()
    transport = open_transport(name, 1_000_000, clock)
    other_end()
    deadline_ns = clock.now_ns() + 3_000_000
    assert transport.read(100, deadline_ns) == b""
    assert clock.now_ns() >= deadline_ns
    transport.close()


def test_stale_input_is_dropped(line):
    name, other_end = line
    clock = DeadlineClock()
    transport = open_transport(name, 1_000_000, clock)
    fd = other_end()
    os.write(fd, b"old")
    assert transport.read(1, clock.now_ns() + 5_000_000_000) == b"o"  # the rest has arrived as well
    transport.discard_input()
    assert transport.read(100, 0) == b""
    transport.close()


def test_a_line_that_hangs_up_is_an_os_error_whatever_is_asked_of_it(hang_up):
    transport, clock = hang_up
    with pytest.raises(OSError):
        transport.read(10, clock.now_ns() + 5_000_000_000)
    with pytest.raises(OSError):
        transport.discard_input()
    with pytest.raises(OSError):
        transport.write(b"x")
    transport.close()


@pytest.fixture(params=["socket", "pty"])
def hang_up(request, tmp_path):
    """A transport whose other end has just gone, as when an adapter is unplugged."""
    clock = DeadlineClock()
    if request.param == "pty":
        master, slave = os.openpty()
        tty.setraw(slave)
        transport = open_transport(os.ttyname(slave), 1_000_000, clock)
        os.close(slave)
        os.close(master)
    else:
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(str(tmp_path / "line"))
        listener.listen()
        transport = open_transport(f"unix:{tmp_path / 'line'}", 1_000_000, clock)
        listener.accept()[0].close()
        listener.close()
    return transport, clock


def test_a_line_that_takes_nothing_more_is_no_lost_port(line):
    name, other_end = line
    transport = open_transport(name, 1_000_000, DeadlineClock())
    other_end()
    sent = 0
    for _ in range(10_000):  # nobody reads: sooner or later the buffers are full
        accepted = transport.write(bytes(4096))
        sent += accepted
        if accepted == 0:
            break
    assert accepted == 0
    assert sent > 0
    transport.close()


@pytest.mark.parametrize("name", ["/dev/no-such-adapter", "unix:/tmp/no-such-line"])
def test_a_port_that_is_not_there_is_refused_with_a_remedy(name):
    with pytest.raises(InputError, match="no-such"):
        open_transport(name, 1_000_000, DeadlineClock())


def test_a_name_with_wildcards_is_the_first_that_opens(tmp_path):
    clock = DeadlineClock()
    (tmp_path / "tty-a").write_text("no device, and in front in the alphabet")
    master, slave = os.openpty()
    try:
        (tmp_path / "tty-b").symlink_to(os.ttyname(slave))
        open_transport(str(tmp_path / "tty-*"), 1_000_000, clock).close()
        with pytest.raises(InputError, match="tty-a"):
            open_transport(str(tmp_path / "tty-[a]"), 1_000_000, clock)
        with pytest.raises(InputError, match="plug in"):
            open_transport(str(tmp_path / "none-*"), 1_000_000, clock)
    finally:
        os.close(master)
        os.close(slave)


def test_a_clock_that_is_set_back_ends_the_wait_for_a_reply():
    clock = SimClock(7_200_000_000_000)
    port = DeadlinePort(None, clock)
    port.deadline_ns = clock.now_ns() + 8_000_000
    assert not port.isPacketTimeout()
    clock._now_ns -= 3_600_000_000_000
    assert port.isPacketTimeout()
