"""Blends: goals without jumps at the start, after missed slots and after a replug."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.core.motion import KINDS, Motion
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from tests.firmware_py.safety.supervised import EXACT_S, LIMITS, first_goal_after, started

PERIOD_S = 0.017
angles = st.floats(-0.4, 0.4)


@given(angles, angles, st.sampled_from([0.5, 1.0, 2.0]))
def test_goals_start_where_the_arm_stands_and_end_in_the_motion(stands, desired, limit):
    limits = msgspec.structs.replace(LIMITS, rate_rad_s=limit)
    supervisor = started(limits, at=stands, desired=desired)
    before, velocity, ticks = stands, 0.0, 0
    while abs(supervisor.goal_rad[0] - desired) > 1e-12 or ticks == 0:
        goal = first_goal_after(supervisor, desired)
        assert supervisor.state is SafetyState.RUNNING
        rate = (goal - before) / EXACT_S
        assert abs(rate) <= 0.25 * limit * (1 + 1e-9)
        assert abs(rate - velocity) / EXACT_S <= LIMITS.acceleration_rad_s2
        before, velocity, ticks = goal, rate, ticks + 1
        assert ticks <= math.ceil(64 * max(1.0, 7.5 * abs(stands - desired) / limit))


@given(st.integers(1, 2), st.integers(20, 200))
def test_skipped_slots_make_no_jump_in_goal_or_speed(missed, slot):
    goals = Motion().table_rad()
    supervisor = started(Limits(), period_s=PERIOD_S)
    rows = [k for k in range(400) if not slot <= k < slot + missed]
    admitted = []
    for k in rows:
        if k == slot + missed:
            supervisor.rebase(goals[k - 1])
        admitted.append(supervisor.admit(goals[k])[0])
    assert supervisor.state is SafetyState.RUNNING
    rates = np.diff(admitted) / PERIOD_S
    assert np.abs(rates).max() < 0.85, "the study's motion has 0.756 rad/s"
    # The motion's own acceleration, gathered while slots were skipped, and the fading's.
    own_rad_s2 = np.abs(np.diff(goals[:400, 0], 2)[1:]).max() / PERIOD_S**2
    worst_rad_s2 = np.abs(np.diff(rates[1:])).max() / PERIOD_S
    assert worst_rad_s2 < (missed + 1) * own_rad_s2 + 5.8 * missed * 0.756 * PERIOD_S
    assert admitted[-1] == pytest.approx(goals[399, 0], abs=1e-12)


@given(angles, st.integers(0, 255), st.sampled_from([0.5, 1.0, 2.0]))
def test_a_motion_taken_up_in_its_midst_is_reached_from_rest_within_the_limits(stands, slot, rate):
    limits = msgspec.structs.replace(LIMITS, rate_rad_s=rate, angle_rad=(-0.4, 0.4))
    goals = 0.4 * np.sin(2 * np.pi * np.arange(2000) / 256 / 4)
    supervisor = started(limits, at=stands)
    supervisor.resume()
    before, velocity = stands, 0.0
    for desired in goals[slot : slot + 700]:
        goal = first_goal_after(supervisor, desired)
        assert supervisor.state is SafetyState.RUNNING, supervisor.reason
        assert -0.4 <= goal <= 0.4
        assert abs((goal - before) / EXACT_S - velocity) <= 0.02, "no step in the speed"
        velocity, before = (goal - before) / EXACT_S, goal
    ticks = math.ceil(1.875 * (0.4 + abs(stands)) / (0.25 * rate) / EXACT_S)
    if ticks < 700:
        assert goal == pytest.approx(desired, abs=1e-12)


def test_a_slot_missed_while_a_motion_is_taken_up_begins_that_anew():
    supervisor = started(at=0.2)
    supervisor.resume()
    for _ in range(20):
        goal = first_goal_after(supervisor, -0.3)
    supervisor.rebase(np.array([-0.3]))
    assert first_goal_after(supervisor, -0.3) == pytest.approx(goal, abs=1e-4)
    assert supervisor.state is SafetyState.RUNNING


def joining(stands, motion, limits=LIMITS):
    """Goals of a join into a motion that is known, and the ticks that it takes."""
    supervisor = started(limits, at=stands)
    supervisor.resume(np.array([value]) for value in motion)
    goals = [stands]
    while not supervisor.following:
        goals.append(first_goal_after(supervisor, motion[len(goals) - 1]))
        assert supervisor.state is SafetyState.RUNNING, supervisor.reason
    return np.array(goals), len(goals) - 1


@given(angles, st.floats(0.05, 0.4), st.integers(0, 1023), st.sampled_from([0.5, 1.0, 2.0]))
def test_a_join_takes_as_long_as_its_distance_needs(stands, amplitude, slot, rate):
    limits = msgspec.structs.replace(LIMITS, rate_rad_s=rate)
    motion = amplitude * np.sin(2 * np.pi * (np.arange(3000) + slot) / 1024)
    goals, ticks = joining(stands, motion, limits)
    farthest = np.abs(motion[:ticks] - stands).max()
    needed = max(1.0, 7.5 * farthest / rate) / EXACT_S
    longest = max(1.0, 7.5 * (0.5 + abs(stands)) / rate) / EXACT_S
    assert ticks <= math.ceil(longest)
    assert ticks >= min(needed, longest) - 1
    largest_step = np.abs(np.diff(motion[: ticks + 1])).max()
    assert np.abs(np.diff(goals)).max() <= largest_step + 0.25 * rate * EXACT_S * 1.001
    assert abs(goals[1] - stands) < 1e-4


def test_a_join_takes_as_long_as_the_farthest_joint_needs():
    at, desired = np.array([0.0, 0.45]), np.array([0.0, -0.5])
    supervisor = SafetySupervisor(LIMITS, 2, EXACT_S)
    supervisor.arm(at)
    supervisor.start()
    supervisor.rebase(at)
    supervisor.resume()
    goals = [at]
    while not supervisor.following:
        goals.append(supervisor.admit(desired).copy())
    assert np.abs(np.diff(goals, axis=0)).max() <= 0.25 * EXACT_S * 1.001
    assert goals[-1] == pytest.approx(desired, abs=1e-12)


@pytest.mark.parametrize(("distance", "ticks"), [(0.1, 64), (0.4, 192)])
def test_a_motion_that_waits_nearby_is_joined_sooner(distance, ticks):
    assert joining(-0.1, np.full(900, distance - 0.1))[1] == ticks


@pytest.mark.parametrize("slot", [16, 144])
def test_a_join_leaves_room_beside_a_motion_that_is_almost_at_the_limit(slot):
    """Blend and motion add up; where a slower blend leaves room for both, it is taken."""
    limits = msgspec.structs.replace(LIMITS, angle_rad=(-1.0, 1.0))
    motion = 0.95 * np.sin(2 * np.pi * np.arange(3000) / 256) / (2 * np.pi / 4)
    goals, ticks = joining(0.0, motion[slot:], limits)
    longest = 480  # 7.5 rad over 1 rad/s
    assert ticks == longest or np.abs(np.diff(goals)).max() <= 0.9 * EXACT_S * (1 + 1e-9)


def test_once_a_motion_is_taken_up_a_missed_slot_keeps_its_speed():
    supervisor = started(at=0.1)
    supervisor.resume()
    for _ in range(1000):
        goal = first_goal_after(supervisor, 0.1)
    step = 0.5 * EXACT_S
    first_goal_after(supervisor, goal + step)
    supervisor.rebase(np.array([goal + 2 * step]))
    assert first_goal_after(supervisor, goal + 3 * step) == pytest.approx(goal + 2 * step, abs=1e-5)


def test_without_a_time_to_blend_a_small_offset_is_gone_at_once():
    supervisor = started(msgspec.structs.replace(LIMITS, blend_s=0.0), at=1e-4, desired=0.0)
    assert first_goal_after(supervisor, 0.0) == 0.0


# --- the way to where a motion begins -----------------------------------------------------------


def approached(supervisor, start):
    """The goals of an approach, from the one that stands on."""
    goals = [supervisor.goal_rad[0]]
    for _ in range(supervisor.approach(np.full(1, start))):
        goals.append(first_goal_after(supervisor, start))
    return np.array(goals)


@settings(deadline=None)  # it simulates a whole motion; a busy machine must not fail it
@given(
    st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)),
    st.sampled_from([k for k in KINDS if k != "decay"]),
    st.floats(0.05, 0.6),
    st.floats(0.0, 6.0),
)
def test_a_motion_within_the_limits_is_run_from_wherever_the_arm_stands(
    stands, kind, amplitude, phase
):
    goals = Motion(kind, amplitude, phase_2_rad=phase, dof=2).table_rad()
    rates = np.diff(goals, axis=0, prepend=goals[:1]) / PERIOD_S
    accelerations = np.diff(rates, axis=0, prepend=np.zeros((1, 2))) / PERIOD_S
    # No more than the motion itself needs.
    limits = Limits(rate_rad_s=np.abs(rates).max(), acceleration_rad_s2=np.abs(accelerations).max())
    supervisor = SafetySupervisor(limits, 2, PERIOD_S)
    supervisor.arm(np.array(stands))
    supervisor.start()
    for _ in range(supervisor.approach(goals[0])):
        supervisor.admit(goals[0])
    assert supervisor.goal_rad.tolist() == goals[0].tolist()
    for row in goals:
        assert supervisor.admit(row).tolist() == row.tolist(), supervisor.reason


@pytest.mark.parametrize("stands", [-0.5, -0.5 + 1e-6, 1e-9, 0.2, 0.5])
def test_an_approach_starts_at_rest_where_the_arm_stands_and_ends_at_rest(stands):
    goals = approached(started(at=stands), 0.0)
    steps = np.diff(goals)
    assert (goals[0], goals[-1]) == (stands, 0.0)
    assert len(steps) * EXACT_S >= LIMITS.blend_s
    assert np.all(steps * -np.sign(stands) >= 0), "never back"
    assert abs(steps[0]) + abs(steps[-1]) <= 2e-4 * abs(stands)
    assert started(at=0.25).approach(np.array([0.25])) == 0, "there is nowhere to go"


@pytest.mark.parametrize(
    ("rate_rad_s", "acceleration_rad_s2", "order"), [(0.25, 64.0, 1), (64.0, 0.25, 2)]
)
def test_an_approach_takes_a_quarter_of_what_is_allowed(rate_rad_s, acceleration_rad_s2, order):
    limits = msgspec.structs.replace(
        LIMITS, rate_rad_s=rate_rad_s, acceleration_rad_s2=acceleration_rad_s2, blend_s=0.0
    )
    goals = approached(started(limits, at=-0.5), 0.5)
    peak = np.abs(np.diff(goals, order)).max() / EXACT_S**order
    assert 0.993 < peak / (0.25 * 0.25) <= 1.0
