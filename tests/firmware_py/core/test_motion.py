"""Reference motions as functions of time, and the files that describe them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.config import read_config
from firmware_py.core.errors import InputError
from firmware_py.core.motion import (
    GLIDE_S,
    KINDS,
    JointSeries,
    Motion,
    MotionConfig,
    MotionDocument,
    read_motion_document,
)

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

SERIES = """
schema = 1
duration_s = 10.0
harmonics = [0, 1, 3]
payload_kg = 1.0
[[joints]]
sine_rad = [0.0, 0.2, 0.05]
cosine_rad = [0.1, -0.1, 0.02]
"""
KIND = """
schema = 1
kind = "triangle"
amplitude_rad = 0.2
period_s = 3.0
payload_kg = 1.0
"""
SERVO = '[[servos]]\nid = {}\nmodel = "XM430-W350"\n'
ROBOT = 'bundle = "b"\n[bus]\nport = "p"\n{}[motion]\nfile = "motion.toml"\n'


@pytest.fixture
def motion_file(tmp_path):
    path = tmp_path / "motion.toml"
    path.write_text(SERIES)
    return path


def robot(directory, servos=1, rest=""):
    text = ROBOT.format("".join(SERVO.format(k + 1) for k in range(servos))) + rest
    (directory / "robot.toml").write_text(text)
    return read_config(directory / "robot.toml")


def test_the_goals_are_the_series_between_rest_at_zero_and_rest_at_zero(motion_file):
    motion = Motion.designed(read_motion_document(motion_file))
    at = 2 * np.pi * 0.4
    inside = 0.1 + 0.2 * np.sin(at) - 0.1 * np.cos(at)
    inside += 0.05 * np.sin(3 * at) + 0.02 * np.cos(3 * at)
    np.testing.assert_allclose(motion.goal_rad(4.0), [inside], rtol=1e-12)
    step_s = 1e-4
    for end_s in (0.0, 10.0):
        near = motion.goal_rad(end_s + step_s * np.arange(-2, 3))[:, 0]
        assert np.max(np.abs(np.diff(near))) / step_s < 1e-3  # the window has no slope there
    assert not np.any(motion.goal_rad([-1.0, 0.0, 10.0, 12.0]))
    assert motion.duration_s == 10.0
    assert motion.amplitude_rad == pytest.approx(np.max(np.abs(motion.table_rad(1e-3))), rel=1e-4)
    series = tuple(JointSeries(sine_rad=(a,), cosine_rad=(0.0,)) for a in (0.1, 0.2))
    two = MotionDocument(schema=1, duration_s=4.0, harmonics=(1,), joints=series)
    np.testing.assert_allclose(Motion.designed(two).goal_rad(1.0), [0.1, 0.2])


@pytest.mark.parametrize(
    ("text", "before", "after", "sentence"),
    [
        (SERIES, "schema = 1", "schema = 7", "schema version 7"),
        (SERIES, "duration_s = 10.0", "duration_s = 0.0", "lasts 0 s"),
        (SERIES, "harmonics = [0, 1, 3]", "harmonics = [1, 1, 3]", "harmonics that differ"),
        (SERIES, "harmonics = [0, 1, 3]", "harmonics = [0, 1, 300]", "above 10 Hz"),
        (SERIES, "[0.0, 0.2, 0.05]", "[0.0, nan, 0.05]", "not finite"),
        (SERIES, "[0.0, 0.2, 0.05]", "[0.0, 2.0, 0.05]", "more than 1.57 rad"),
        (SERIES, "[[joints]]", "[joint]", "is no motion"),
        (SERIES, "schema = 1", "schema =", "is not TOML"),
        (SERIES, "payload_kg = 1.0", "payload_kg = -1.0", "payload of -1 kg"),
        (KIND, "schema = 1", "schema = 7", "schema version 7"),
        (KIND, '"triangle"', '"circle"', "is no motion"),
        (KIND, "amplitude_rad = 0.2", "amplitude_rad = 2.0", "motion.toml: its amplitude is 114"),
        (KIND, "period_s = 3.0", "", "period_s"),
    ],
)
def test_a_wrong_motion_file_is_refused_in_one_sentence(tmp_path, text, before, after, sentence):
    path = tmp_path / "motion.toml"
    path.write_text(text.replace(before, after))
    with pytest.raises(InputError, match=sentence):
        MotionConfig().with_motion(str(path))


def test_a_robot_runs_the_motion_file_that_it_names(tmp_path, motion_file):
    config = robot(tmp_path)
    rest = round(config.motion.rest_s / config.period_s)
    expected = Motion.designed(read_motion_document(motion_file)).table_rad(config.period_s, rest)
    np.testing.assert_array_equal(config.goals_rad(), expected)
    again = config.goals_rad(repeated=True)
    np.testing.assert_array_equal(again[len(expected) :], 0.0)
    with pytest.raises(InputError, match=r"has 1 joints, the robot 2"):
        robot(tmp_path, servos=2).goals_rad()


def test_a_motion_file_may_name_a_kind(tmp_path):
    (tmp_path / "motion.toml").write_text(KIND)
    motion = robot(tmp_path, rest="rest_s = 0.5\n").motion
    assert motion.motion(1) == Motion("triangle", 0.2, 3.0) and motion.rest_s == 0.5
    again = MotionConfig(kind="steps").with_motion(str(tmp_path / "motion.toml"))
    assert again.motion(2) == Motion("triangle", 0.2, 3.0, dof=2)


def test_the_command_line_takes_a_kind_or_a_file(tmp_path, motion_file):
    motion = robot(tmp_path).motion
    assert motion.with_motion("triangle").motion(1).name == "triangle"
    assert motion.with_motion(str(motion_file)).motion(1).name.startswith("designed-")
    with pytest.raises(InputError, match="no kind of motion and no file"):
        motion.with_motion("circle")
