"""Trapezoidal profile of a goal, against the rig's, which is integrated in small steps."""

import casadi as ca
import numpy as np
import pytest

from models.plant.components.goal import NO_ACCELERATION_LIMIT, profiled_change
from models.rig.forms import ProfiledGoal

STEP_S = 0.017
FINE = 500


@pytest.fixture(scope="module")
def profile():
    arguments = [ca.SX.sym(name) for name in ("left", "rate", "speed", "acceleration", "step")]
    change = profiled_change(*arguments)
    slopes = ca.jacobian(ca.vertcat(*change), ca.vertcat(*arguments))
    return ca.Function("profile", arguments, [*change, slopes])


def set_point(profile, goals, speed, acceleration):
    """Set-point and its rate after each step."""
    at = rate = 0.0
    rows = []
    for goal in goals:
        change, rate, _ = map(np.array, profile(goal - at, rate, speed, acceleration, STEP_S))
        at, rate = at + change.item(), rate.item()
        rows.append((at, rate))
    return np.array(rows).T


def motion(rng):
    """A sinusoid with jumps to either side, some before the last one is finished."""
    return 0.5 * np.sin(1.45 * STEP_S * np.arange(300)) + np.repeat(rng.normal(0, 0.1, 20), 15)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("speed, acceleration", [(100.0, 12.0), (0.6, 12.0), (100.0, 60.0)])
def test_the_profile_is_the_one_that_is_integrated_in_small_steps(
    profile, seed, speed, acceleration
):
    goals = motion(np.random.default_rng(seed))
    fine = ProfiledGoal(STEP_S / FINE, speed, acceleration)
    expected = []
    for goal in goals:
        fine.take(goal)
        for _ in range(FINE):
            at = fine.advance()
        expected.append(at)
    found, _ = set_point(profile, goals, speed, acceleration)
    fastest = np.sqrt(acceleration)  # of 1 rad; the small steps are late by about one of them
    np.testing.assert_allclose(found, expected, atol=2 * fastest * STEP_S / FINE)


@pytest.mark.parametrize("seed", range(4))
def test_speed_and_acceleration_stay_within_their_limits(profile, seed):
    goals = motion(np.random.default_rng(seed))
    found, rate = set_point(profile, goals, 0.6, 12.0)
    assert np.abs(np.diff(found)).max() <= 0.6 * STEP_S * (1 + 1e-9)
    assert np.abs(rate).max() <= 0.6 * (1 + 1e-9)
    assert np.abs(np.diff(rate)).max() <= 12.0 * STEP_S * (1 + 1e-9)


def test_without_a_limit_a_goal_is_reached_in_its_step_exactly(profile):
    goals = motion(np.random.default_rng(5))
    found, rate = set_point(profile, goals, 1e6, NO_ACCELERATION_LIMIT)
    np.testing.assert_allclose(found, goals, rtol=0, atol=1e-15)
    assert not rate.any()


def test_derivatives_are_finite_at_rest(profile):
    *_, slopes = profile(0.0, 0.0, 100.0, 12.0, STEP_S)
    assert np.isfinite(np.array(slopes)).all()
