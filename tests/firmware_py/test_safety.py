"""The supervisor: every limit just inside, at and just outside, and no goal that jumps."""

import math
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus import BusStatus
from firmware_py.errors import InputError
from firmware_py.motion import KINDS, Motion
from firmware_py.safety import TRANSITIONS, Limits, SafetySupervisor, State, check_motion

PERIOD_S = 0.017
TIP = np.array([0.1, 0.0, 1.0])
# Powers of two, so that "at the limit" is exact.
LIMITS = Limits(
    angle_rad=(-0.5, 0.5), rate_rad_s=1.0, acceleration_rad_s2=64.0, current_a=4.0,
    following_error_rad=0.25, jump_rad=0.125,
    tip_min_m=(-1.0, -1.0, 0.0), tip_max_m=(1.0, 1.0, 1.5),
    persistence_ticks=3, stale_ticks=3, blend_s=1.0, stop_deceleration_rad_s2=8.0, hold_s=0.5,
)  # fmt: skip
EXACT_S = 1 / 64
INSIDE, AT, OUTSIDE = -1e-6, 0.0, 1e-6


def started(limits=LIMITS, at=0.0, dof=1, period_s=EXACT_S, wished=None):
    supervisor = SafetySupervisor(limits, dof, period_s)
    supervisor.arm(np.full(dof, at))
    assert supervisor.state is State.READY
    supervisor.start()
    supervisor.rebase(np.full(dof, at if wished is None else wished))
    return supervisor


def check(supervisor, angle=0.0, current=0.0, status=BusStatus.OK, **changed):
    given_ = {"alert": 0, "tip_m": TIP, "di": 0.01, "missed": 0} | changed
    return supervisor.check(status, given_["alert"], np.array([angle]), np.array([current]),
                            given_["tip_m"], given_["di"], given_["missed"])  # fmt: skip


def stopped_after(supervisor, ticks=3, **measured):
    """States over some ticks with the same measurement."""
    return [check(supervisor, **measured) is State.STOPPING for _ in range(ticks)]


# --- measurements ---------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("beyond", "stops"), [(INSIDE, False), (AT, False), (OUTSIDE, True)])
def test_current_at_its_limit(sign, beyond, stops):
    measured = {"current": sign * (4.0 + beyond)}
    assert stopped_after(started(), **measured) == [False, False, stops]


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("beyond", "stops"), [(INSIDE, False), (AT, False), (OUTSIDE, True)])
def test_following_error_at_its_limit(sign, beyond, stops):
    supervisor = started(msgspec.structs.replace(LIMITS, jump_rad=1.0))
    assert stopped_after(supervisor, angle=sign * (0.25 + beyond)) == [False, False, stops]


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("beyond", "stops"), [(INSIDE, False), (AT, False), (OUTSIDE, True)])
def test_measured_angle_at_its_limit(sign, beyond, stops):
    supervisor = started(at=sign * 0.5)
    # Goal at 0.5, so 0.75 is at both the following error's and the angle's limit; the angle
    # speaks first.
    supervisor._angle[0] = sign * 0.75
    assert stopped_after(supervisor, angle=sign * (0.75 + beyond)) == [False, False, stops]
    if stops:
        assert "outside its limits" in supervisor.reason


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("beyond", "stops"), [(INSIDE, False), (AT, False), (OUTSIDE, True)])
def test_encoder_jump_at_its_limit(sign, beyond, stops):
    supervisor = started(msgspec.structs.replace(LIMITS, following_error_rad=1.0))
    step = sign * (0.125 + beyond)
    states = [check(supervisor, angle=k % 2 * step) for k in range(1, 4)]
    assert [s is State.STOPPING for s in states] == [False, False, stops]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", ["tip_min_m", "tip_max_m"])
@pytest.mark.parametrize(("beyond", "stops"), [(INSIDE, False), (AT, False), (OUTSIDE, True)])
def test_tip_at_the_wall_of_its_box(axis, side, beyond, stops):
    tip_m = TIP.copy()
    outwards = beyond if side == "tip_max_m" else -beyond
    tip_m[axis] = getattr(LIMITS, side)[axis] + outwards
    assert stopped_after(started(), tip_m=tip_m) == [False, False, stops]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("what", ["tip_m", "di", "angle", "current"])
def test_a_value_that_is_no_number_stops_the_robot(what, bad):
    value = np.array([bad, 0.0, 1.0]) if what == "tip_m" else bad
    assert stopped_after(started(), **{what: value}) == [False, False, True]


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("what", ["angle", "current", "goal", "start"])
def test_the_joint_at_fault_is_named(what, joint):
    supervisor = started(dof=2)
    bad = np.array([9.0 if j == joint else 0.0 for j in (1, 2)])
    still = np.zeros(2)
    if what == "start":
        with pytest.raises(InputError, match=f"joint {joint}"):
            SafetySupervisor(LIMITS, 2, EXACT_S).arm(bad)
        return
    if what == "goal":
        supervisor.admit(bad)
    for _ in range(3):
        supervisor.check(BusStatus.OK, 0, bad if what == "angle" else still,
                         bad if what == "current" else still, TIP, 0.0, 0)  # fmt: skip
    assert f"joint {joint} " in supervisor.reason


def test_a_single_wild_sample_is_forgiven():
    supervisor = started()
    for current in (9.0, 9.0, 0.0, 9.0, 9.0, 0.0):
        assert check(supervisor, current=current) is State.RUNNING


@pytest.mark.parametrize(("ticks", "stops"), [(1, False), (2, False), (3, True)])
def test_stale_data_degrades_and_then_stops(ticks, stops):
    supervisor = started()
    for _ in range(ticks):
        state = check(supervisor, status=BusStatus.TIMEOUT)
    assert state is (State.STOPPING if stops else State.DEGRADED)
    assert supervisor.stale_ticks == ticks
    assert ("no fresh data" in supervisor.reason) is stops
    if not stops:
        assert check(supervisor) is State.RUNNING
        assert supervisor.stale_ticks == 0


def test_missed_slots_count_as_stale_ticks():
    supervisor = started()
    assert check(supervisor, status=BusStatus.CORRUPT) is State.DEGRADED
    assert check(supervisor, status=BusStatus.CORRUPT, missed=1) is State.STOPPING


@pytest.mark.parametrize(("missed", "stops"), [(1, False), (2, False), (3, True)])
def test_a_long_stall_stops_the_robot(missed, stops):
    assert (check(started(), missed=missed) is State.STOPPING) is stops


def test_a_hardware_error_stops_at_once_and_is_named():
    supervisor = started()
    assert check(supervisor, status=BusStatus.ALERT, alert=0b100) is State.STOPPING
    assert supervisor.tripped
    assert "overheating" in supervisor.reason


# --- goals ----------------------------------------------------------------------------------


def first_goal_after(supervisor, *wished):
    for value in wished:
        goal = supervisor.admit(np.array([value]))
    return goal[0]


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("beyond", "stops"), [(INSIDE, False), (AT, False), (OUTSIDE, True)])
def test_goal_angle_at_its_limit(sign, beyond, stops):
    supervisor = started(at=sign * 0.5)
    first_goal_after(supervisor, sign * (0.5 + beyond))
    assert (supervisor.state is State.STOPPING) is stops
    assert abs(supervisor.goal_rad[0]) <= 0.5


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("beyond", "stops"), [(INSIDE, False), (AT, False), (OUTSIDE, True)])
def test_goal_rate_at_its_limit(sign, beyond, stops):
    supervisor = started()
    step = EXACT_S  # 1 rad/s, reached with 64 rad/s2
    first_goal_after(supervisor, sign * step * (1 + beyond))
    assert (supervisor.state is State.STOPPING) is stops
    assert ("rad/s," in supervisor.reason) is stops


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("beyond", "stops"), [(INSIDE, False), (AT, False), (OUTSIDE, True)])
def test_goal_acceleration_at_its_limit(sign, beyond, stops):
    limits = msgspec.structs.replace(LIMITS, acceleration_rad_s2=32.0)
    supervisor = started(limits)
    first_goal_after(supervisor, sign * 32.0 * EXACT_S**2 * (1 + beyond))
    assert (supervisor.state is State.STOPPING) is stops
    assert ("rad/s2" in supervisor.reason) is stops


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_goal_that_is_no_number_is_never_admitted(bad):
    supervisor = started()
    first_goal_after(supervisor, 0.001, bad)
    assert supervisor.state is State.STOPPING
    assert np.all(np.isfinite(supervisor.goal_rad))


angles = st.floats(-0.4, 0.4)


@given(angles, angles, st.sampled_from([0.5, 1.0, 2.0]))
def test_goals_start_where_the_arm_stands_and_end_in_the_motion(stands, wished, limit):
    limits = msgspec.structs.replace(LIMITS, rate_rad_s=limit)
    supervisor = started(limits, at=stands, wished=wished)
    before, velocity, ticks = stands, 0.0, 0
    while abs(supervisor.goal_rad[0] - wished) > 1e-12 or ticks == 0:
        goal = first_goal_after(supervisor, wished)
        assert supervisor.state is State.RUNNING
        rate = (goal - before) / EXACT_S
        assert abs(rate) <= 0.25 * limit * (1 + 1e-9)
        assert abs(rate - velocity) / EXACT_S <= LIMITS.acceleration_rad_s2
        before, velocity, ticks = goal, rate, ticks + 1
        assert ticks <= math.ceil(64 * max(1.0, 7.5 * abs(stands - wished) / limit))


def test_a_motion_that_starts_where_the_arm_stands_is_followed_to_the_bit():
    goals = Motion(dof=2).table_rad()
    supervisor = SafetySupervisor(Limits(), 2)
    supervisor.arm(np.zeros(2))
    supervisor.start()
    supervisor.rebase(goals[0])
    for row in goals:
        assert supervisor.admit(row).tolist() == row.tolist()


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
    assert supervisor.state is State.RUNNING
    rates = np.diff(admitted) / PERIOD_S
    assert np.abs(rates).max() < 0.85, "the study's motion has 0.756 rad/s"
    # The motion's own acceleration, gathered while slots were skipped, and the fading's.
    own_rad_s2 = np.abs(np.diff(goals[:400, 0], 2)[1:]).max() / PERIOD_S**2
    worst_rad_s2 = np.abs(np.diff(rates[1:])).max() / PERIOD_S
    assert worst_rad_s2 < (missed + 1) * own_rad_s2 + 5.8 * missed * 0.756 * PERIOD_S
    assert admitted[-1] == pytest.approx(goals[399, 0], abs=1e-12)


@given(st.floats(-0.9, 0.9), st.floats(-0.4, 0.4))
def test_a_controlled_stop_slows_down_holds_and_ends(rate, at):
    supervisor = started(at=at)
    supervisor._velocity[0] = rate
    supervisor.request_stop("enough")
    assert supervisor.state is State.STOPPING
    positions = [at]
    while supervisor.state is State.STOPPING:
        positions.append(first_goal_after(supervisor, math.nan))
        assert len(positions) < 200
    rates = np.diff(positions) / EXACT_S
    decelerations = -np.diff(np.abs([rate, *rates])) / EXACT_S
    assert np.all((decelerations >= -1e-9) & (decelerations <= 8.0 + 1e-9))
    still = np.flatnonzero(rates)[-1] if rates.any() else -1
    assert (len(rates) - 1 - still) * EXACT_S == 0.5, "held for hold_s"
    assert supervisor.state is State.OFF
    assert not supervisor.tripped


def test_a_controlled_stop_does_not_leave_the_limits():
    supervisor = started(at=0.49)
    supervisor._velocity[0] = 0.9
    supervisor.request_stop("enough")
    while supervisor.state is State.STOPPING:
        assert 0.49 <= first_goal_after(supervisor, 0.0) <= 0.5


def test_the_first_reason_stands():
    supervisor = started()
    check(supervisor, status=BusStatus.ALERT, alert=1)
    supervisor.request_stop("SIGTERM")
    assert "input voltage" in supervisor.reason
    assert supervisor.tripped


@pytest.mark.parametrize(
    ("at", "refused"), [(0.5, False), (0.5 + 1e-6, True), (-0.6, True), (math.nan, True)]
)
def test_a_robot_that_stands_outside_its_limits_does_not_start(at, refused):
    supervisor = SafetySupervisor(LIMITS, 1, EXACT_S)
    if refused:
        with pytest.raises(InputError, match="by hand"):
            supervisor.arm(np.array([at]))
        assert supervisor.state is State.STARTING
    else:
        supervisor.arm(np.array([at]))


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("kind", [k for k in KINDS if k != "decay"])
def test_the_default_limits_admit_the_motions(kind, dof):
    check_motion(Motion(kind, dof=dof).table_rad(), Limits(), PERIOD_S, kind)


def test_a_motion_beyond_the_limits_is_refused_before_it_starts():
    with pytest.raises(InputError, match=r"motion decay: the goal of joint 1 moves at .* rad/s"):
        check_motion(Motion("decay").table_rad(), Limits(), PERIOD_S, "motion decay")


# --- slots missed over a time, and a robot that takes up a motion in its midst ---------------


@pytest.mark.parametrize(("missed", "stops"), [(11, False), (12, False), (13, True)])
def test_slots_missed_one_at_a_time_at_their_limit(missed, stops):
    supervisor = started()
    for _ in range(missed):
        check(supervisor, missed=1)
    assert (supervisor.state is State.STOPPING) is stops
    assert ("too slow" in supervisor.reason) is stops


@pytest.mark.parametrize("punctual", [0, 1, 2])
def test_a_punctual_tick_makes_up_for_one_missed_slot(punctual):
    supervisor = started()
    for _ in range(punctual + 1):  # the first finds nothing to make up for
        check(supervisor)
    for _ in range(12):
        check(supervisor, missed=1)
    assert supervisor.state is State.RUNNING
    for _ in range(punctual):
        check(supervisor)
    for _ in range(punctual):
        check(supervisor, missed=1)
    assert supervisor.state is State.RUNNING
    check(supervisor, missed=1)
    assert supervisor.state is State.STOPPING


@given(angles, st.integers(0, 255), st.sampled_from([0.5, 1.0, 2.0]))
def test_a_motion_taken_up_in_its_midst_is_reached_from_rest_within_the_limits(stands, slot, rate):
    limits = msgspec.structs.replace(LIMITS, rate_rad_s=rate, angle_rad=(-0.4, 0.4))
    goals = 0.4 * np.sin(2 * np.pi * np.arange(2000) / 256 / 4)
    supervisor = started(limits, at=stands)
    supervisor.resume()
    before, velocity = stands, 0.0
    for wished in goals[slot : slot + 700]:
        goal = first_goal_after(supervisor, wished)
        assert supervisor.state is State.RUNNING, supervisor.reason
        assert -0.4 <= goal <= 0.4
        assert abs((goal - before) / EXACT_S - velocity) <= 0.02, "no step in the speed"
        velocity, before = (goal - before) / EXACT_S, goal
    ticks = math.ceil(1.875 * (0.4 + abs(stands)) / (0.25 * rate) / EXACT_S)
    if ticks < 700:
        assert goal == pytest.approx(wished, abs=1e-12)


def test_a_slot_missed_while_a_motion_is_taken_up_begins_that_anew():
    supervisor = started(at=0.2)
    supervisor.resume()
    for _ in range(20):
        goal = first_goal_after(supervisor, -0.3)
    supervisor.rebase(np.array([-0.3]))
    assert first_goal_after(supervisor, -0.3) == pytest.approx(goal, abs=1e-4)
    assert supervisor.state is State.RUNNING


def test_a_robot_whose_port_is_back_starts_with_a_clean_slate():
    supervisor = started()
    check(supervisor, missed=2)
    for _ in range(3):
        check(supervisor, status=BusStatus.PORT_GONE)
    first_goal_after(supervisor, 0.0)
    while supervisor.state is not State.OFF:
        supervisor.admit(np.zeros(1))
    supervisor.restart()
    assert (supervisor.state, supervisor.reason, supervisor.tripped) == (State.STARTING, "", False)
    assert supervisor.stale_ticks == 0
    supervisor.arm(np.array([0.3]))
    supervisor.start()
    for _ in range(12):
        assert check(supervisor, angle=0.3, missed=1) is State.RUNNING


def test_the_machine_makes_no_step_that_is_not_drawn():
    steps = {(t.source, t.target) for t in TRANSITIONS}
    assert (State.STARTING, State.RUNNING) not in steps
    with pytest.raises(ValueError, match="STARTING does not lead to RUNNING"):
        SafetySupervisor(LIMITS, 1, EXACT_S).start()
    with pytest.raises(ValueError, match="RUNNING does not lead to STARTING"):
        started().restart()
    reached = {State.STARTING}
    for _ in State:
        reached |= {t.target for t in TRANSITIONS if t.source in reached}
    assert reached == set(State)


def test_the_default_limits_are_those_that_robot_toml_shows():
    document = tomllib.loads((Path(__file__).parents[2] / "robot.toml").read_text())
    assert msgspec.convert(document["limits"], Limits) == Limits()
    assert set(document["limits"]) == set(Limits.__struct_fields__)


@pytest.mark.parametrize(("at", "wished"), [(0.3, -0.4), (-0.3, 0.4)])
def test_a_motion_far_away_is_taken_up_slowly(at, wished):
    supervisor = started(at=at)
    supervisor.resume()
    before, ticks = at, 0
    while before != wished:
        goal = first_goal_after(supervisor, wished)
        assert abs(goal - before) / EXACT_S <= 0.25 * (1 + 1e-9)
        before, ticks = goal, ticks + 1
        assert ticks < 1000


def test_once_a_motion_is_taken_up_a_missed_slot_keeps_its_speed():
    supervisor = started(at=0.1)
    supervisor.resume()
    for _ in range(1000):
        goal = first_goal_after(supervisor, 0.1)
    step = 0.5 * EXACT_S
    first_goal_after(supervisor, goal + step)
    supervisor.rebase(np.array([goal + 2 * step]))
    assert first_goal_after(supervisor, goal + 3 * step) == pytest.approx(goal + 2 * step, abs=1e-5)


@pytest.mark.parametrize("tick", [1, 2, 32, 63, 64])
def test_an_offset_fades_along_a_quintic_from_the_first_tick_to_the_last(tick):
    supervisor = started(at=0.01, wished=0.0)  # blend_s is 64 ticks
    for _ in range(tick):
        goal = first_goal_after(supervisor, 0.0)
    x = tick / 64
    share = 1 - (6 * x**5 - 15 * x**4 + 10 * x**3)
    assert goal == pytest.approx(0.01 * share, abs=1e-15)


def test_without_a_time_to_blend_a_small_offset_is_gone_at_once():
    supervisor = started(msgspec.structs.replace(LIMITS, blend_s=0.0), at=1e-4, wished=0.0)
    assert first_goal_after(supervisor, 0.0) == 0.0


def test_without_a_time_to_hold_the_torque_goes_off_at_rest():
    supervisor = started(msgspec.structs.replace(LIMITS, hold_s=0.0))
    supervisor.request_stop("enough")
    first_goal_after(supervisor, 0.0)
    assert supervisor.state is State.OFF


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_restarted_robot_is_at_rest(sign):
    supervisor = started()
    first_goal_after(supervisor, *(0.5 * EXACT_S * k for k in range(1, 4)))
    supervisor.request_stop("enough")
    while supervisor.state is not State.OFF:
        supervisor.admit(np.zeros(1))
    supervisor.restart()
    supervisor.arm(np.zeros(1))
    supervisor.start()
    supervisor.rebase(np.zeros(1))
    first_goal_after(supervisor, sign * EXACT_S)  # at the limits of rate and acceleration
    assert supervisor.state is State.RUNNING


def test_a_fresh_supervisor_has_nothing_to_complain_about():
    fresh = SafetySupervisor(LIMITS, 1, EXACT_S)
    assert (fresh.state, fresh.reason, fresh.tripped) == (State.STARTING, "", False)
    assert fresh.stale_ticks == 0
