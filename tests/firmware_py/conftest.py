"""A bundle with an observer, and a robot whose servo is in memory behind a socket."""

import contextlib
import shutil
import socket
import threading

import pytest

from dropstitch.__main__ import main
from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.servo_models import MODELS

CONFIG = """
bundle = "{bundle}"
[bus]
port = "unix:{port}"
reply_timeout_s = 0.017
[[servos]]
id = 1
model = "H54-200-S500-R"
[motion]
amplitude_rad = 0.02
period_s = 0.4
rest_s = 0.2
[limits]
hold_s = 0.05
stale_ticks = 100 # the servos share a busy machine with the tests
missed_slots = 1000
[real_time]
priority = 0
lock_memory = false
"""


@pytest.fixture(scope="session")
def observer_bundle(toy_bundle, tmp_path_factory):
    """Directory of the toy's bundle with the observer of the nominal plant."""
    directory = shutil.copytree(toy_bundle, tmp_path_factory.mktemp("observer") / "bundle")
    plant = str(directory / "plant.json")
    assert main(["fmu", "build", str(directory), "--plant", plant, "--unit", "observer"]) == 0
    return directory


@pytest.fixture
def servos(tmp_path):
    """A servo in memory behind `tmp_path/line`, for one connection."""
    transport = LoopbackTransport({1: MODELS[54024]})
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "line"))
    listener.listen()

    def serve():
        with contextlib.suppress(OSError), listener.accept()[0] as connection:
            while data := connection.recv(4096):
                transport.write(data)
                if answer := transport.read(4096, 0):
                    connection.sendall(answer)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield transport
    listener.shutdown(socket.SHUT_RDWR)  # a test that never connected
    thread.join()
    listener.close()


@pytest.fixture
def config(tmp_path, toy_bundle):
    """Configuration of the robot with that servo; change its text before a run."""
    path = tmp_path / "robot.toml"
    path.write_text(CONFIG.format(bundle=toy_bundle, port=tmp_path / "line"), encoding="utf-8")
    return path


@pytest.fixture
def call(capsys):
    """Exit code and output of a command."""

    def call(*arguments):
        code = main([str(a) for a in arguments])
        return code, capsys.readouterr()

    return call
