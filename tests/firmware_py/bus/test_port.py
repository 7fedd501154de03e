"""Port under deadlines, over bytes in memory, a socket and a pseudo-terminal."""

import fcntl
import os
import socket
import termios
import threading
import tty

import pytest

from firmware_py.bus import transport as transport_module
from firmware_py.bus.port import DeadlinePort
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.transport import open_transport
from firmware_py.core.errors import InputError
from firmware_py.system.clock import DeadlineClock, SimClock
from tests.firmware_py.bus.tampered import PRO_A, TapeTransport, make

PATIENCE_NS = 5_000_000_000


def test_a_lost_reply_costs_the_time_to_the_deadline_and_not_a_nanosecond_more():
    clock = SimClock(5_000_000)
    port = DeadlinePort(TapeTransport(clock), clock)
    port.deadline_ns = 13_000_000
    assert port.receive() == (None, BusStatus.TIMEOUT)
    assert clock.now_ns() == 13_000_000
    assert port.wait_ns == 8_000_000


@pytest.fixture(params=["socket", "pty"])
def line(request, tmp_path):
    """A transport, its clock, the descriptor of the other end, and a call that hangs up."""
    clock = DeadlineClock()
    if request.param == "pty":
        fd, slave = os.openpty()
        tty.setraw(slave)
        transport = open_transport(os.ttyname(slave), 1_000_000, clock)
        ends = [fd, slave]

        def hang_up():
            while ends:
                os.close(ends.pop())

    else:
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(str(tmp_path / "line"))
        listener.listen()
        transport = open_transport(f"unix:{tmp_path / 'line'}", 1_000_000, clock)
        other = listener.accept()[0]
        fd = other.fileno()

        def hang_up():
            other.close()
            listener.close()

    yield transport, clock, fd, hang_up
    transport.close()
    hang_up()


def test_bytes_pass_through_a_real_transport_both_ways(line):
    transport, clock, fd, _ = line
    assert transport.write(b"\xff\x00\x0a\x0d\x11\x13") == 6
    assert os.read(fd, 100) == b"\xff\x00\x0a\x0d\x11\x13"
    answer = threading.Thread(target=os.write, args=(fd, b"\x03\x04\xfd"))
    answer.start()
    assert transport.read(100, clock.now_ns() + PATIENCE_NS) == b"\x03\x04\xfd"
    answer.join()


def test_a_silent_line_gives_nothing_at_the_deadline_and_stale_input_is_dropped(line):
    transport, clock, fd, _ = line
    deadline_ns = clock.now_ns() + 3_000_000
    assert transport.read(100, deadline_ns) == b""
    assert clock.now_ns() >= deadline_ns
    os.write(fd, b"old")
    assert transport.read(1, clock.now_ns() + PATIENCE_NS) == b"o"  # the rest has arrived as well
    transport.discard_input()
    assert transport.read(100, 0) == b""


def test_a_line_that_hangs_up_is_an_os_error(line):
    transport, clock, _, hang_up = line
    hang_up()
    for use in (
        lambda: transport.read(10, clock.now_ns() + PATIENCE_NS),
        transport.discard_input,
        lambda: transport.write(b"x"),
    ):
        with pytest.raises(OSError):
            use()


def test_a_full_line_accepts_what_fits_and_does_not_block(line):
    transport, *_ = line
    sent = 0
    for _ in range(1000):  # nobody reads: sooner or later the buffers are full
        accepted = transport.write(bytes(4096))
        sent += accepted
        if accepted == 0:
            break
    assert accepted == 0
    assert sent > 0


def test_a_usb_adapter_is_asked_to_pass_bytes_on_at_once(monkeypatch):
    asked, kernels, get, set_ = [], fcntl.ioctl, 0x541E, 0x541F  # TIOCGSERIAL, TIOCSSERIAL

    def ioctl(fd, request, *rest):  # of an adapter whose driver has the settings
        if request not in (get, set_):
            return kernels(fd, request, *rest)
        asked.append((request, rest[0][4]))

    monkeypatch.setattr(transport_module.fcntl, "ioctl", ioctl)
    master, slave = os.openpty()
    try:
        open_transport(os.ttyname(slave), 1_000_000, DeadlineClock()).close()
    finally:
        os.close(master)
        os.close(slave)
    low_latency = 1 << 13
    assert asked == [(get, 0), (set_, low_latency)]


@pytest.mark.parametrize("name", ["/dev/no-such-adapter", "unix:/tmp/no-such-line"])
def test_a_port_that_is_not_there_is_refused_by_name(name):
    with pytest.raises(InputError, match="no-such"):
        open_transport(name, 1_000_000, DeadlineClock())


def test_a_path_that_is_too_long_for_a_socket_is_refused_with_the_reason():
    with pytest.raises(InputError, match="path too long"):
        open_transport(f"unix:{'a' * 200}", 1_000_000, DeadlineClock())


def test_a_device_that_vanishes_while_it_is_opened_is_refused_and_the_next_one_tried(
    tmp_path, monkeypatch
):
    """The serial library does not catch the error of the terminal, which is no OSError."""
    flush, flushed = termios.tcflush, []

    def vanish(fd, queue):
        flushed.append(fd)
        if len(flushed) == 1:
            raise termios.error(5, "Input/output error")
        return flush(fd, queue)

    monkeypatch.setattr(termios, "tcflush", vanish)
    master, slave = os.openpty()
    try:
        for name in ("tty-a", "tty-b"):
            (tmp_path / name).symlink_to(os.ttyname(slave))
        open_transport(str(tmp_path / "tty-*"), 1_000_000, DeadlineClock()).close()
        flushed.clear()
        bus, *_ = make(
            PRO_A,
            opener=lambda: open_transport(str(tmp_path / "tty-a"), 1_000_000, DeadlineClock()),
        )
        assert not bus.reopen()
    finally:
        os.close(master)
        os.close(slave)


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
