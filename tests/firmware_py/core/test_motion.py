"""Reference motions as functions of time, and the files that describe them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.config import read_config
from firmware_py.core.errors import InputError
from firmware_py.core.motion import GLIDE_S, KINDS, Motion, MotionConfig

AMPLITUDE_RAD = np.radians(30.0)


def test_the_study_swings_to_minus_first_twice_in_512_steps():
    goal = Motion().table_rad()
    assert goal.shape == (512, 1)
    # The quarters of a 256-step cycle.
    np.testing.assert_allclose(
        goal[[0, 64, 128, 192, 256, 320, 384, 448], 0],
        AMPLITUDE_RAD * np.array([0, -1, 0, 1, 0, -1, 0, 1]), atol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(goal[:256], goal[256:], atol=1e-12)


def test_both_joints_move_together_at_phase_zero_and_go_round_at_90_degrees():
    together = Motion(dof=2).table_rad()
    np.testing.assert_array_equal(together[:, 0], together[:, 1])
    around = Motion(dof=2, phase_2_rad=np.pi / 2).table_rad()
    np.testing.assert_allclose(np.hypot(*around[130:].T), AMPLITUDE_RAD, rtol=1e-12)
    # Joint 2 leads: it does now what joint 1 will do a quarter of a cycle later.
    np.testing.assert_allclose(around[130:448, 1], around[194:512, 0], atol=1e-12)


@given(
    motion=st.builds(
        Motion,
        kind=st.sampled_from(KINDS),
        amplitude_rad=st.floats(0.0, 1.5),
        period_s=st.floats(0.5, 20.0),
        phase_2_rad=st.floats(-6.3, 6.3),
        dof=st.sampled_from([1, 2]),
    )
)
def test_every_motion_starts_at_rest_stays_in_range_and_comes_back(motion):
    end = motion.duration_s
    time = np.linspace(-1.0, end + GLIDE_S + 1.0, 3000)
    goal = motion.goal_rad(time)
    assert goal.shape == (3000, motion.dof)
    assert np.max(np.abs(goal)) <= motion.amplitude_rad * (1 + 1e-12)
    assert not np.any(goal[time <= 0])
    assert not np.any(goal[time >= end + GLIDE_S])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("phase", [0.0, 1.0, -2.0])
def test_every_motion_uses_its_amplitude_and_only_the_letting_go_jumps(kind, phase):
    goal = Motion(kind, phase_2_rad=phase, dof=2).table_rad()
    jumps = np.abs(np.diff(goal, axis=0)) > 1.5 * 0.017  # faster than 1.5 rad/s
    # The end may cut off the last letting go of a joint that leads or lags.
    assert jumps[:, 0].sum() == (2 if kind == "decay" else 0)
    assert jumps[:, 1].sum() in ((1, 2) if kind == "decay" else (0,))
    if phase == 0.0:
        np.testing.assert_allclose(np.max(np.abs(goal), axis=0), AMPLITUDE_RAD, rtol=1e-3)


@pytest.mark.parametrize("kind", ["sinusoid", "multisine", "steps"])
@pytest.mark.parametrize("phase", [0.0, 1.0, np.pi / 2])
def test_no_motion_ends_in_a_dead_stop(kind, phase):
    step_s = 0.017
    motion = Motion(kind, phase_2_rad=phase, dof=2)
    time_s = np.arange(motion.duration_s - 1.0, motion.duration_s + GLIDE_S + 1.0, step_s)
    change_rad_s = np.abs(np.diff(motion.goal_rad(time_s), n=2, axis=0)) / step_s
    at_full_speed_rad_s = 2 * np.pi * motion.amplitude_rad / motion.period_s
    assert change_rad_s.max() < 0.2 * at_full_speed_rad_s


def test_the_joints_of_a_multisine_share_no_frequency():
    goal = Motion("multisine", dof=2).table_rad()
    first, second = np.abs(np.fft.rfft(goal * np.hanning(len(goal))[:, None], axis=0)).T
    peaks = [set(np.flatnonzero(s > 0.2 * s.max())) for s in (first, second)]
    assert np.argmax(first) != np.argmax(second)
    assert len(peaks[0]) > 1 and len(peaks[1]) > 1
    assert abs(np.corrcoef(goal.T)[0, 1]) < 0.3


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"kind": "waltz"}, "sinusoid"),
        ({"amplitude_rad": 2.0}, "amplitude"),
        ({"amplitude_rad": float("nan")}, "amplitude"),
        ({"period_s": 0.0}, "period"),
        ({"phase_2_rad": float("inf")}, "phase"),
        ({"dof": 3}, "dof"),
    ],
)
def test_impossible_motions_are_refused(values, named):
    with pytest.raises(InputError, match=named):
        Motion(**values)


# --- files --------------------------------------------------------------------------------------

MOTION = """
schema = 1
kind = "triangle"
amplitude_rad = 0.2
period_s = 3.0
payload_kg = 1.0
"""
SERIES = """
schema = 1
duration_s = 10.0
harmonics = [1]
[[joints]]
sine_rad = [0.2]
cosine_rad = [0.1]
"""
ROBOT = """
bundle = "b"
[bus]
port = "p"
[[servos]]
id = 1
model = "XM430-W350"
[motion]
rest_s = 0.5
file = "motion.toml"
"""


@pytest.fixture
def motion_file(tmp_path):
    path = tmp_path / "motion.toml"
    path.write_text(MOTION)
    return path


@pytest.mark.parametrize(
    ("text", "before", "after", "sentence"),
    [
        (MOTION, "schema = 1", "schema = 7", "schema version 7"),
        (MOTION, "schema = 1", "schema =", "is not TOML"),
        (MOTION, '"triangle"', '"circle"', "is no motion"),
        (
            MOTION,
            "amplitude_rad = 0.2",
            "amplitude_rad = 2.0",
            "motion.toml: its amplitude_rad is 2",
        ),
        (MOTION, "period_s = 3.0", "", "period_s"),
        (SERIES, "", "", "is no motion"),  # of releases up to 0.3
    ],
)
def test_a_wrong_motion_file_is_refused_in_one_sentence(tmp_path, text, before, after, sentence):
    path = tmp_path / "motion.toml"
    path.write_text(text.replace(before, after))
    with pytest.raises(InputError, match=sentence):
        MotionConfig().with_motion(str(path))


def test_a_robot_runs_the_motion_file_that_it_names(tmp_path, motion_file):
    (tmp_path / "robot.toml").write_text(ROBOT)
    motion = read_config(tmp_path / "robot.toml").motion
    assert motion.motion(1) == Motion("triangle", 0.2, 3.0) and motion.rest_s == 0.5


def test_the_command_line_takes_a_kind_or_a_file(motion_file):
    motion = MotionConfig(kind="steps")
    assert motion.with_motion("decay").motion(1).kind == "decay"
    assert motion.with_motion(str(motion_file)).motion(2) == Motion("triangle", 0.2, 3.0, dof=2)
    with pytest.raises(InputError, match="no kind of motion and no file"):
        motion.with_motion("circle")
