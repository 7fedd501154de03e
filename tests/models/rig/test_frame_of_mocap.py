"""The rig's motion capture: a turned frame shows every marker turned about its three axes."""

import numpy as np
import pytest

from models.rig.parameters import read_rig
from models.rig.sensors import MarkerLog, read_markers
from models.shared.kinematics import base_rotation

MARKERS_M = np.array([[0.4, -0.1, 0.9], [0.0, 0.2, 0.3]])
TURNS = {"roll": 0.05, "tilt": 0.1, "yaw": -0.2}


def test_a_turned_frame_turns_the_markers_about_z_then_x_then_y():
    quiet = read_rig("default").changed(**{"sensor.marker_noise_m": 0.0})
    turned = quiet.changed(**{f"sensor.frame_{name}_rad": turn for name, turn in TURNS.items()})
    log = MarkerLog(-1.0, 0.01, np.tile(MARKERS_M, (300, 1, 1)))
    shown = read_markers(turned, log, np.array([0.0, 0.5]), np.zeros(3), np.random.default_rng(1))
    cos, sin = np.cos(TURNS["yaw"]), np.sin(TURNS["yaw"])
    about_z = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    rotation = base_rotation(np.array([[TURNS["tilt"], -TURNS["roll"]]]))[0] @ about_z
    assert shown[-1] == pytest.approx(MARKERS_M @ rotation.T, abs=1e-12)
