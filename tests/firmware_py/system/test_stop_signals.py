"""Signals in motion: each that can be handled brings a controlled stop, and none ends the loop."""

import signal
import socket

import pytest

from firmware_py.bus.transport import SocketTransport
from firmware_py.log.telemetry import SocketTelemetry
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from firmware_py.summary import Ended
from firmware_py.system.clock import DeadlineClock
from firmware_py.system.stop_signals import STOP_SIGNALS, signals_to
from tests.firmware_py.simulated_loop import Bus, make


@pytest.fixture(autouse=True)
def default_hangup():
    """Under `nohup` it is ignored."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


def run_with(number):
    """A run that gets a signal in its read 100, and its bus."""

    class SignallingBus(Bus):
        def read(self, deadline_ns):
            if self.reads == 100:
                signal.raise_signal(number)
            return super().read(deadline_ns)

    loop, bus, *_ = make(bus=SignallingBus)
    return loop.run(), bus


@pytest.mark.parametrize(
    "name", ["HUP", "INT", "QUIT", "TERM", "USR1", "USR2", "PIPE", "TSTP", "ALRM", "XCPU"]
)
def test_a_signal_brings_a_controlled_stop(name):
    number = signal.Signals[f"SIG{name}"]
    before = signal.getsignal(number)
    summary, bus = run_with(number)
    assert (summary.ended, summary.reason) == (Ended.SIGNALLED, number.name)
    assert summary.records["state"][100] == SafetyState.STOPPING
    assert summary.ticks > 100 + Limits().hold_s / 0.017
    assert not bus.driven
    assert bus.clock.now_ns() == run_with(signal.SIGTERM)[1].clock.now_ns(), "as soon as SIGTERM"
    assert signal.getsignal(number) is before


def test_every_signal_that_ends_or_halts_a_process_is_handled_but_kill_stop_and_crashes():
    default = {number for number in signal.valid_signals() if number not in STOP_SIGNALS}
    assert default == {
        signal.SIGKILL, signal.SIGSTOP, signal.SIGCHLD, signal.SIGCONT, signal.SIGURG,
        signal.SIGWINCH, signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL,
        signal.SIGABRT, signal.SIGTRAP, signal.SIGSYS,
    }  # fmt: skip


def test_a_hangup_that_nohup_ignores_stays_ignored():
    before, raised = signal.signal(signal.SIGHUP, signal.SIG_IGN), []
    try:
        with signals_to(raised.append):
            signal.raise_signal(signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert raised == []


def test_a_second_signal_does_not_prevent_torque_off():
    loop, bus, *_ = make(slots=10)
    torque = bus.torque

    def interrupted(on):
        if not on:
            signal.raise_signal(signal.SIGINT)
        return torque(on)

    bus.torque = interrupted
    loop.run()
    assert not bus.driven


def test_neither_a_dead_recorder_nor_a_lost_port_raises_a_signal(tmp_path):
    raised = []
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "line"))
    listener.listen()
    telemetry = SocketTelemetry(ours)
    transport = SocketTransport(str(tmp_path / "line"), DeadlineClock())
    listener.accept()[0].close()
    theirs.close()
    with signals_to(raised.append):
        telemetry.put(memoryview(b"record"))
        with pytest.raises(OSError):
            transport.write(b"goals")
    assert (raised, telemetry.drops) == ([], 1)
    for end in (ours, listener, transport):
        end.close()
