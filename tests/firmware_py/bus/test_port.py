"""Port under deadlines, over bytes in memory, a socket and a pseudo-terminal."""

import os
import socket
import threading
import tty

import pytest

from firmware_py.bus import codec
from firmware_py.bus.port import DeadlinePort
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.transport import open_transport
from firmware_py.core.errors import InputError
from firmware_py.system.clock import DeadlineClock, SimClock
from tests.firmware_py.bus.tampered import TapeTransport


def test_a_reply_in_pieces_is_put_together():
    clock = SimClock()
    frame = codec.build_status(1, 0, b"\1\2\3\4")
    port = DeadlinePort(TapeTransport(clock, *(frame[k : k + 1] for k in range(len(frame)))), clock)
    port.deadline_ns = 1
    packet, status = port.receive()
    assert status is BusStatus.OK
    assert packet.parameters == b"\0\1\2\3\4"


def test_a_lost_reply_costs_the_time_to_the_deadline_and_not_a_nanosecond_more():
    clock = SimClock(5_000_000)
    port = DeadlinePort(TapeTransport(clock), clock)
    port.deadline_ns = 13_000_000
    assert port.receive() == (None, BusStatus.TIMEOUT)
    assert clock.now_ns() == 13_000_000
    assert port.wait_ns == 8_000_000


def test_a_clock_that_is_set_back_ends_the_wait_for_a_reply():
    clock = SimClock(7_200_000_000_000)

    class SetBack(TapeTransport):
        def read(self, size, deadline_ns):
            clock._now_ns -= 3_600_000_000_000
            return b""

    port = DeadlinePort(SetBack(clock), clock)
    port.deadline_ns = clock.now_ns() + 8_000_000
    assert port.receive() == (None, BusStatus.TIMEOUT)


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
