"""Reference motions as functions of time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.core.errors import InputError
from firmware_py.core.motion import GLIDE_S, KINDS, Motion

AMPLITUDE_RAD = np.radians(30.0)

motions = st.builds(
    Motion,
    kind=st.sampled_from(KINDS),
    amplitude_rad=st.floats(0.0, 1.5),
    period_s=st.floats(0.5, 20.0),
    phase_2_rad=st.floats(-6.3, 6.3),
    dof=st.sampled_from([1, 2]),
)


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


def test_rest_samples_stand_in_front():
    goal = Motion(dof=2).table_rad(rest_samples=60)
    assert goal.shape == (572, 2)
    assert not np.any(goal[:61])
    assert np.all(goal[61] < 0)


@given(motion=motions)
def test_every_motion_starts_at_rest_stays_in_range_and_comes_back(motion):
    end = motion.duration_s
    time = np.linspace(-1.0, end + GLIDE_S + 1.0, 3000)
    goal = motion.goal_rad(time)
    assert goal.shape == (3000, motion.dof)
    assert np.max(np.abs(goal)) <= motion.amplitude_rad * (1 + 1e-12)
    assert not np.any(goal[time <= 0])
    assert not np.any(goal[time >= end + GLIDE_S])


@pytest.mark.parametrize("kind", KINDS)
def test_every_motion_uses_its_whole_amplitude(kind):
    goal = Motion(kind, dof=2).table_rad()
    np.testing.assert_allclose(np.max(np.abs(goal), axis=0), AMPLITUDE_RAD, rtol=1e-3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("phase", [0.0, 1.0, -2.0])
def test_only_the_letting_go_is_a_jump(kind, phase):
    goal = Motion(kind, phase_2_rad=phase, dof=2).table_rad()
    jumps = np.abs(np.diff(goal, axis=0)) > 1.5 * 0.017  # faster than 1.5 rad/s
    # The end may cut off the last letting go of a joint that leads or lags.
    assert jumps[:, 0].sum() == (2 if kind == "decay" else 0)
    assert jumps[:, 1].sum() in ((1, 2) if kind == "decay" else (0,))


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
    correlation = np.corrcoef(goal.T)[0, 1]
    assert abs(correlation) < 0.3


def test_one_time_gives_one_goal_per_joint():
    motion = Motion(dof=2)
    np.testing.assert_array_equal(motion.goal_rad(1.0), motion.goal_rad([1.0])[0])


@pytest.mark.parametrize(
    "values, named",
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
