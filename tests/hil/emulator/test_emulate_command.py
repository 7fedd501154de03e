"""`dropstitch emulate`, spoken to by the official SDK, untouched."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import dynamixel_sdk as sdk
import pytest

from dropstitch.__main__ import main
from firmware_py.system.clock import RealTimeOptions
from models.plant.plant import NOMINAL


def started(*options):
    """A process that emulates, and the name of its port."""
    process = subprocess.Popen(
        [
            sys.executable, "-m", "dropstitch", "emulate", "--model", "PH54-200-S500-R",
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
    process, port = started("--line", "pty", "--ids", "1", "2")
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
def test_a_termination_leaves_no_socket(tmp_path):
    path = tmp_path / "bus"
    process, port = started("--line", "socket", "--path", path)
    assert port == f"unix:{path}" and path.exists()
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
        goal = 20_000
        assert patient(handler.write4ByteTxRx, port, 1, 564, goal) == (sdk.COMM_SUCCESS, 0)
        position = 0
        for _ in range(3000):  # as long as it takes: the plant runs in real time
            position, result, _ = handler.read4ByteTxRx(port, 1, 580)
            if result == sdk.COMM_SUCCESS and abs(position - goal) < 100:
                break
        assert abs(position - goal) < 100
        still, result, _ = patient(handler.read4ByteTxRx, port, 2, 580)
        assert min(still, 2**32 - still) < 100, "the second one got no goal"
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
