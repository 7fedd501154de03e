"""`dropstitch emulate`, spoken to by the official SDK, untouched."""

import os
import signal
import subprocess
import sys

import dynamixel_sdk as sdk
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.servo_setup import ServoSetup
from firmware_py.bus.transport import SocketTransport
from firmware_py.system.clock import DeadlineClock, RealTimeOptions
from models.plant.plant import NOMINAL


def started(model, *options):
    """A process that emulates, and the name of its port."""
    process = subprocess.Popen(
        [
            sys.executable, "-m", "dropstitch", "emulate", "--model", model,
            "--plant", str(NOMINAL), "--baud", "1000000", *map(str, options),
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # A shell that runs the tests in the background passes on that SIGINT is ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    return process, process.stdout.readline().strip()


@pytest.fixture(scope="module")
def emulating():
    """A process behind whose port two PH54 stand, and the name of that port."""
    process, port = started("PH54-200-S500-R", "--line", "pty", "--ids", "1", "2")
    yield process, port
    granted = policy_of(process) == os.SCHED_FIFO
    process.send_signal(signal.SIGINT)
    error = process.communicate(timeout=30)[1]
    assert process.returncode == 0
    assert error.count("real-time priority") == (not granted)


def policy_of(process):
    return os.sched_getscheduler(process.pid) & ~os.SCHED_RESET_ON_FORK


def test_the_servos_ask_for_the_priority_of_a_loop_and_not_for_more(emulating):
    process, _ = emulating
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    except OSError:
        assert policy_of(process) == os.SCHED_OTHER
        return
    os.sched_setscheduler(0, *before)
    assert policy_of(process) == os.SCHED_FIFO
    assert os.sched_getparam(process.pid).sched_priority <= RealTimeOptions().priority


@pytest.mark.slow
def test_our_bus_drives_the_socket_and_a_termination_leaves_none(tmp_path):
    path, clock = tmp_path / "bus", DeadlineClock()
    # A legacy Pro has no watchdog that a busy machine would trip.
    process, port = started("H54-200-S500-R", "--line", "socket", "--path", path)
    assert port == f"unix:{path}"
    for _ in range(2):  # a program may come back
        setups = [ServoSetup(1, MODELS[54024], -1.0, 1.0)]
        bus = DynamixelBus(SocketTransport(str(path), clock), setups, clock, period_s=0.017)
        bus.connect()
        assert bus.torque(True) is BusStatus.OK
        for _ in range(5):
            assert bus.write(np.array([0.2]), clock.now_ns() + 10**9) is BusStatus.OK
            assert bus.read(clock.now_ns() + 10**9) is BusStatus.OK
        assert bus.angle_rad.all()
        bus.close()
    process.terminate()
    error = process.communicate(timeout=30)[1]
    assert process.returncode == 143 and error.endswith("terminated\n")
    assert not path.exists()


def test_the_sdk_moves_the_plant_and_sees_it_move(emulating, patient):
    port, handler = sdk.PortHandler(emulating[1]), sdk.PacketHandler(2.0)
    assert port.openPort() and port.setBaudRate(1_000_000)
    try:
        assert patient(handler.ping, port, 2) == (2020, sdk.COMM_SUCCESS, 0)
        assert patient(handler.write1ByteTxRx, port, 1, 512, 1) == (sdk.COMM_SUCCESS, 0)
        assert sorted(patient(handler.broadcastPing, port)[0]) == [1, 2]
        refused = patient(handler.write4ByteTxRx, port, 1, 580, 1)
        assert refused == (sdk.COMM_SUCCESS, sdk.protocol2_packet_handler.ERRNUM_ACCESS)
        goal = 20_000
        assert patient(handler.write4ByteTxRx, port, 1, 564, goal) == (sdk.COMM_SUCCESS, 0)
        position = 0
        for _ in range(3000):  # as long as it takes: the plant runs in real time
            position, result, _ = handler.read4ByteTxRx(port, 1, 580)
            if result == sdk.COMM_SUCCESS and abs(position - goal) < 100:
                break
        assert abs(position - goal) < 100
        still, result, _ = patient(handler.read4ByteTxRx, port, 2, 580)
        assert min(still, 2**32 - still) < 100, "the second one has no torque"
        group = sdk.GroupSyncWrite(port, handler, 564, 4)
        reader = sdk.GroupSyncRead(port, handler, 564, 4)
        for servo, raw in ((1, goal), (2, 1000)):
            assert group.addParam(servo, raw.to_bytes(4, "little")) and reader.addParam(servo)
        assert group.txPacket() == sdk.COMM_SUCCESS
        assert patient(reader.txRxPacket) == sdk.COMM_SUCCESS
        assert [reader.getData(servo, 564, 4) for servo in (1, 2)] == [goal, 1000]
    finally:
        port.closePort()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--model", "AX-12", "--plant", str(NOMINAL)], "AX-12"),
        (["--plant", "missing.json"], "missing.json"),
        (["--fmu", "missing.fmu"], "missing.fmu"),
        (["--plant", str(NOMINAL), "--ids", "1", "1"], "--ids"),
        (["--plant", str(NOMINAL), "--ids", "1", "2", "3"], "dof"),
        (["--plant", str(NOMINAL), "--baud", "1"], "--baud"),
        (["--plant", str(NOMINAL), "--faults", "gremlins=1"], "gremlins"),
    ],
)
def test_what_cannot_be_emulated_is_refused_in_one_sentence(arguments, complaint, capsys):
    assert main(["emulate", *arguments]) == 2
    error = capsys.readouterr().err
    assert complaint in error.splitlines()[-1] and "Traceback" not in error
