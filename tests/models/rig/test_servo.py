"""The servo with each of its forms: friction, goals, feed-forward, and what its registers show."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.core.signals import PERIOD_S
from models.rig.drawn import rig_named
from models.rig.parameters import read_parameters
from models.rig.servo import ProfiledGoal, RigServo, goal_form
from tests.models.rig.rigs import with_structure

STEP_S = 1e-3
STEPS = round(PERIOD_S / STEP_S)


def blocked(servo, joint_rad=0.0, seconds=2.0, start_s=0.0):
    """Torque after running against a joint that does not move; the largest current on the way."""
    torque = largest_a = 0.0
    for k in range(round(seconds / STEP_S)):
        torque = servo.step(start_s + k * STEP_S, joint_rad, 0.0)
        largest_a = max(largest_a, abs(servo.current_a))
    return torque, largest_a


def test_the_encoder_does_not_measure_the_play_of_the_gear(parameters):
    play = 0.01
    servo = RigServo(parameters.changed(**{"servo.backlash_rad": play}), STEP_S)
    assert blocked(servo, joint_rad=0.4 * play)[0] == 0.0
    assert servo.encoder_rad == pytest.approx(0.0, abs=1e-6)
    assert blocked(servo, joint_rad=0.7 * play)[0] < 0.0  # the teeth push the joint back


def test_current_stays_within_its_limit_and_does_not_wind_up(parameters):
    servo = RigServo(parameters.hide({"current_saturation": 7.0}), STEP_S)
    servo.send(0.5, 0.0)
    assert blocked(servo, seconds=1.5)[1] == pytest.approx(3.0)
    servo.send(0.0, 1.5)
    blocked(servo, seconds=0.3, start_s=1.5)
    assert abs(servo.current_a) < 2.9


@pytest.mark.parametrize("kind, rate, share", [("lugre", 0.1, 0.0), ("smooth", -0.5, 0.3)])
def test_friction_at_constant_speed_is_coulomb_plus_viscous_plus_load(kind, rate, share):
    """Turn goal and joint together: the current at speed overcomes friction and load only."""
    rig = with_structure(read_parameters(), friction=kind)
    p = rig.changed(**{"servo.load_friction_share": share, "servo.dead_time_s": 0.0})
    servo, load = RigServo(p, STEP_S), 6.0
    stretch = load * p["servo.gear_compliance_rad_nm"] + 0.5 * p["servo.backlash_rad"]
    for k in range(6000):
        servo.send(rate * k * STEP_S, k * STEP_S)
        # The joint follows where the gear would pass on exactly the load.
        servo.step(k * STEP_S, servo.rotor_rad - stretch, servo.rotor_rad_s)
    friction = (4.5 + share * load) * np.sign(rate) + 2.0 * rate
    assert servo.gear_nm == pytest.approx(load, rel=1e-3)
    assert servo.current_a * 6.83 == pytest.approx(load + friction, rel=0.02)


@pytest.mark.parametrize(
    "name, dead_s", [("default", 0.0496), ("drive", 0.0504), ("profile", 0.0504)]
)
def test_dead_time_delays_the_goal_to_the_nearest_step(name, dead_s):
    servo = RigServo(rig_named(name).changed(**{"servo.dead_time_s": dead_s}), STEP_S)
    servo.send(0.1, 0.0)
    for k in range(50):
        servo.step(k * STEP_S, 0.0, 0.0)
        assert servo.current_a == 0.0
    servo.step(0.05, 0.0, 0.0)
    assert servo.current_a > 0.0


# ---- set-point -----------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_profile_stays_within_its_velocity_and_acceleration(seed):
    rng = np.random.default_rng(seed)
    velocity, acceleration = rng.uniform(0.3, 3.0), rng.uniform(2.0, 40.0)
    goal = ProfiledGoal(STEP_S, velocity, acceleration)
    way = [0.0, 0.0]
    for wanted in 0.5 * rng.standard_normal(40):
        goal.take(wanted)
        way += [goal.advance() for _ in range(rng.integers(1, 80))]
    rates = np.diff(way) / STEP_S
    assert np.abs(rates).max() <= velocity * (1 + 1e-9)
    assert np.abs(np.diff(rates)).max() / STEP_S <= acceleration * (1 + 1e-6)


@pytest.mark.parametrize("name", ["default", "drive", "profile"])
def test_a_goal_on_a_ramp_moves_at_its_rate_and_stops_when_no_goal_comes(name):
    goal = goal_form(rig_named(name), STEP_S)
    for k in range(1, 60):
        goal.take(0.4 * PERIOD_S * k)
        rates = [(goal.advance(), goal.rate_rad_s)[1] for _ in range(STEPS)]
    assert np.mean(rates) == pytest.approx(0.4, rel=1e-3)
    for _ in range(3 * STEPS):
        goal.advance()
    assert goal.rate_rad_s == pytest.approx(0.0, abs=1e-12)


def lag_on_a_ramp(feedforward, integral):
    """Lag of a frictionless servo in rad, in the middle of a period, after 4 s at 0.4 rad/s."""
    rig = rig_named("drive").changed(**{
        "servo.velocity_feedforward": feedforward, "servo.position_integral_per_s2": integral,
        "servo.coulomb_friction_nm": 0.0, "servo.viscous_friction_nm_s_rad": 0.0,
        "servo.load_friction_share": 0.0, "servo.velocity_integral_rad_s": 0.0,
        "servo.backlash_rad": 1e3,
    })  # fmt: skip
    servo = RigServo(with_structure(rig, position_loop="feedforward"), STEP_S)
    for k in range(round(4.0 / STEP_S)):
        if k % STEPS == 0:
            goal_rad = 0.4 * STEP_S * (k + STEPS)
            servo.send(goal_rad, k * STEP_S)
        servo.step(k * STEP_S, 0.0, 0.0)
    return goal_rad - 0.4 * STEP_S * (STEPS - 1 - k % STEPS) - servo.rotor_rad


def test_feedforward_takes_its_share_of_the_lag_and_the_position_integral_all_of_it():
    none = lag_on_a_ramp(0.0, 0.0)
    assert none == pytest.approx(0.4 / read_parameters()["servo.position_gain_per_s"], rel=0.02)
    assert lag_on_a_ramp(0.3, 0.0) == pytest.approx(0.7 * none, rel=0.02)
    assert abs(lag_on_a_ramp(1.0, 0.0)) < 0.02 * none
    assert abs(lag_on_a_ramp(0.0, 20.0)) < 0.05 * none


# ---- the register of the current -----------------------------------------------------------------


@pytest.mark.parametrize(
    "name, steps_ago", [("default", [0]), ("profile", [8]), ("drive", range(STEPS))]
)
def test_the_register_has_the_current_of_the_tick_of_a_phase_or_a_mean(name, steps_ago):
    """Half of the 17 steps of a period are 8."""
    rig = rig_named(name).changed(**{"sensor.current_lag_s": 0.0})
    servo, history = RigServo(rig, STEP_S), []
    servo.send(0.01, 0.0)
    for k in range(200):
        servo.step(k * STEP_S, 0.0, 0.0)
        history.append(servo.current_a)
    assert np.ptp(history[-STEPS:]) > 0.01
    expected = np.mean([history[-1 - steps] for steps in steps_ago])
    assert servo.sampled_current_a == pytest.approx(expected)
