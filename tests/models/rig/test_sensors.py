"""Motion capture: play in the mount, the filters of its software, and its frame."""

import numpy as np
import pytest

from models.rig.drawn import rig_named
from models.rig.rig import MarkerPlay
from models.rig.sensors import MarkerLog, filtered_frames, read_markers
from models.shared.kinematics import base_rotation

PLAY_RAD, RATE_HZ = 0.004, 240.0
FILTERS = {"none": "default", "low_pass": "test_a", "zero_phase": "capture"}


@pytest.fixture
def play():
    rig = rig_named("capture").changed(**{"servo.backlash_rad": PLAY_RAD})
    return MarkerPlay(rig, 2, 1e-3)


def push(play, *torque_nm):
    for _ in range(500):
        play.advance(torque_nm)


def test_the_link_leans_within_its_play_against_the_drive(play):
    push(play, 8.0, -8.0)
    np.testing.assert_allclose(play.lean_rad, [-0.5 * PLAY_RAD, 0.5 * PLAY_RAD], rtol=1e-3)
    push(play, -8.0, -8.0)
    np.testing.assert_allclose(play.lean_rad, 0.5 * PLAY_RAD, rtol=1e-3)
    for torque in 5.0 * np.random.default_rng(3).standard_normal((500, 2)):
        play.advance(torque)
        assert np.abs(play.lean_rad).max() <= 0.5 * PLAY_RAD


def test_markers_lean_about_the_axis_of_their_joint(play, rigid_markers):
    angle = np.array([0.3, -0.2])
    for torque in ([-8.0, 0.0], [0.0, -8.0]):
        push(play, *torque)
        shown = play.shown_m(rigid_markers(angle[None])[0], angle)
        turned = rigid_markers((angle + play.lean_rad)[None])[0]
        np.testing.assert_allclose(shown, turned, atol=1e-8)


def filtered(kind, values):
    """The same course in every coordinate of every marker, filtered at 10 Hz."""
    rig = rig_named(FILTERS[kind]).changed(**{"sensor.mocap_cutoff_hz": 10.0})
    assert rig.structure.mocap_filter == kind
    frames = np.broadcast_to(values[:, None, None], (len(values), 16, 3))
    return filtered_frames(rig, frames)[:, 3, 1]


@pytest.mark.parametrize(
    "kind, lag_s, gain",
    [("none", 0.0, 1.0), ("zero_phase", 0.0, 0.5),
     ("low_pass", np.sqrt(2) / (20 * np.pi), np.sqrt(0.5))],
)  # fmt: skip
def test_lag_on_a_ramp_and_gain_at_the_cut_off_are_those_of_the_filter(kind, lag_s, gain):
    """Of a Butterworth filter of second order: a lag of sqrt(2) over the angular cut-off."""
    np.testing.assert_allclose(filtered(kind, np.full(300, 0.7)), 0.7, atol=1e-9)
    time_s = np.arange(2400) / RATE_HZ
    late = time_s - filtered(kind, time_s)
    np.testing.assert_allclose(late[200:400], lag_s, atol=2e-4)
    shown = filtered(kind, np.sin(2 * np.pi * 10.0 * time_s))[600:1800]
    assert np.sqrt(2 * np.mean(shown**2)) == pytest.approx(gain, rel=0.01)


def test_a_turned_frame_turns_the_markers_about_z_then_x_then_y():
    markers_m = np.array([[0.4, -0.1, 0.9], [0.0, 0.2, 0.3]])
    turns = {"roll": 0.05, "tilt": 0.1, "yaw": -0.2}
    quiet = rig_named("default").changed(**{"sensor.marker_noise_m": 0.0})
    turned = quiet.changed(**{f"sensor.frame_{name}_rad": turn for name, turn in turns.items()})
    log = MarkerLog(-1.0, 0.01, np.tile(markers_m, (300, 1, 1)))
    shown = read_markers(turned, log, np.array([0.0, 0.5]), np.zeros(3), np.random.default_rng(1))
    cos, sin = np.cos(turns["yaw"]), np.sin(turns["yaw"])
    about_z = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    rotation = base_rotation(np.array([[turns["tilt"], -turns["roll"]]]))[0] @ about_z
    assert shown[-1] == pytest.approx(markers_m @ rotation.T, abs=1e-12)
