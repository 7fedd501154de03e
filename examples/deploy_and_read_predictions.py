"""Start the robot's loop, lead it along a sinusoid, and read its predictions over the socket.

Emulated servos stand for the robot. On the robot PC leave `emulate` out and name the servos' port:

    python examples/deploy_and_read_predictions.py
"""

import contextlib
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import msgspec

from firmware_py.goals.goal_channel import GoalMessage, StatusMessage, connect, encode_goal

ROOT = Path(__file__).resolve().parents[1]
BUNDLE = ROOT / "docs/notebooks/bundle_1dof"
CONFIG = """schema = 1
bundle = "{bundle}"
record = false
bus = {{ port = "{port}" }}
servos = [{{ id = 1, model = "H54-200-S500-R" }}]
"""


def start(*command: object, **options: object) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-m", "dropstitch", *command], cwd=ROOT, **options)


def follow(address: str, seconds: float = 5.0) -> None:
    """Answer every status with a goal; print what the robot predicts twice a second."""
    while not Path(address.removeprefix("unix:")).exists():
        time.sleep(0.05)
    with connect(address) as robot:
        while data := robot.recv(4096):
            status = msgspec.json.decode(data, type=StatusMessage)
            goal = (0.15 - 0.15 * math.cos(1.5 * max(status.time_s, 0.0)),)
            end = status.time_s > seconds
            robot.send(encode_goal(GoalMessage(status.tick, None if end else goal, end=end)))
            if status.tick % 30 == 0:
                print(f"{status.time_s:5.2f} s  {status.state}  tip x {status.tip_m[0]:+.3f} m")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        servos = ("emulate", "--model", "H54-200-S500-R", "--plant", BUNDLE / "plant.json")
        emulator = start(*servos, stdout=subprocess.PIPE, text=True)
        port, config = emulator.stdout.readline().strip(), Path(scratch) / "robot.toml"
        config.write_text(CONFIG.format(bundle=BUNDLE, port=port), encoding="utf-8")
        goals = f"unix:{scratch}/goals"
        robot = start("run", "--config", config, "--goals", goals)
        with contextlib.suppress(ConnectionError):  # the robot has stopped
            follow(goals)
        code = robot.wait()
        emulator.terminate()
    sys.exit(code)
