"""Forms of the servo: friction, set-point and the sampling of its current."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.signals import PERIOD_S
from models.rig.forms import (
    CurrentRegister,
    ProfiledGoal,
    friction_form,
    goal_form,
)
from models.rig.parameters import read_parameters, read_rig
from models.rig.servo import RigServo

STEP_S = 1e-3
STEPS = round(PERIOD_S / STEP_S)
INERTIA = read_parameters()["servo.inertia_kg_m2"]
FRICTIONS = {"lugre": "default", "smooth": "drive"}


def friction(kind):
    rig = read_rig(FRICTIONS[kind])
    assert rig.structure.friction == kind
    return friction_form(rig, STEP_S)


def coast(built, rate, level, drive=0.0, seconds=3.0):
    """Rates of the rotor under friction and a constant torque."""
    rates = [rate]
    for _ in range(round(seconds / STEP_S)):
        torque = drive - built.torque_nm(rates[-1], level, drive)
        rates.append(rates[-1] + STEP_S * torque / INERTIA)
    return np.array(rates)


@pytest.mark.parametrize("kind", FRICTIONS)
@pytest.mark.parametrize("rate", [0.5, -0.5])
def test_friction_at_speed_is_its_level_and_the_viscous_term(kind, rate):
    built, viscous = friction(kind), read_parameters()["servo.viscous_friction_nm_s_rad"]
    drive = math.copysign(4.5 + viscous * 0.5, rate)
    torque = [built.torque_nm(rate, 4.5, drive) for _ in range(200)][-1]
    assert torque == pytest.approx(drive, rel=1e-3)


@pytest.mark.parametrize("kind", FRICTIONS)
@pytest.mark.parametrize("level", [0.0, 4.5, 30.0])
def test_a_coasting_rotor_comes_to_rest_without_gaining_energy(kind, level):
    rates = coast(friction(kind), 2.0, level)
    settled = np.abs(rates[-500:]).max()
    assert np.abs(rates).max() <= 2.0
    assert settled < (1e-3 if level else 2.0)


def test_smooth_friction_never_drives_the_rotor():
    rates = coast(friction("smooth"), 2.0, 30.0)
    assert np.all(np.diff(rates) <= 0) and rates.min() >= 0.0


def test_smooth_friction_gives_way_slowly_where_a_bristle_holds():
    """Below its level g, at the rate w_0 r / sqrt(1 - r^2) of the load's ratio r = 0.5 (B = 0)."""
    smooth = coast(friction("smooth"), 0.0, 4.5, drive=2.25)[-1]
    rate_0 = read_parameters()["servo.smooth_rate_rad_s"]
    assert smooth == pytest.approx(rate_0 * 0.5 / math.sqrt(0.75), rel=0.01)
    assert abs(coast(friction("lugre"), 0.0, 4.5, drive=2.25)[-1]) < 0.01 * smooth


def test_a_held_goal_is_the_set_point_at_once():
    goal = goal_form(read_rig("default"), STEP_S)
    goal.take(0.1)
    assert goal.advance() == 0.1


def test_an_interpolated_goal_is_reached_on_a_line_after_one_period():
    goal = goal_form(read_rig("drive"), STEP_S)
    for wanted in (0.1, -0.3, 0.2):
        start = goal.advance()
        goal.take(wanted)
        way = np.array([goal.advance() for _ in range(STEPS)])
        line = start + (wanted - start) * np.arange(1, STEPS + 1) / STEPS
        np.testing.assert_allclose(way, line, atol=1e-12)
        assert goal.advance() == wanted


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_profile_keeps_its_velocity_and_acceleration_whatever_is_asked(seed):
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


@pytest.mark.parametrize("way_rad", [1.0, -0.02, 1e-5])
def test_a_profile_from_rest_takes_the_time_of_the_trapezoid(way_rad):
    velocity, acceleration = 1.5, 10.0
    goal = ProfiledGoal(STEP_S, velocity, acceleration)
    goal.take(way_rad)
    way = np.array([goal.advance() for _ in range(2000)])
    reached_s = STEP_S * (1 + np.flatnonzero(np.abs(way - way_rad) > 1e-6).max(initial=-1))
    size = abs(way_rad)
    if size > velocity**2 / acceleration:
        expected_s = size / velocity + velocity / acceleration
    else:
        expected_s = 2.0 * math.sqrt(size / acceleration)
    assert reached_s == pytest.approx(expected_s, abs=4 * STEP_S)
    # A step is the coarseness of an overshoot: an eighth of what one step of acceleration moves.
    assert np.abs(way).max() <= size + acceleration * STEP_S**2 / 8
    assert way[-1] == pytest.approx(way_rad, abs=1e-12)


@pytest.mark.parametrize("name", ["default", "drive", "profile"])
def test_a_goal_on_a_ramp_moves_at_its_rate_and_stands_when_no_goal_comes(name):
    goal = goal_form(read_rig(name), STEP_S)
    for k in range(1, 60):
        goal.take(0.4 * PERIOD_S * k)
        rates = [(goal.advance(), goal.rate_rad_s)[1] for _ in range(STEPS)]
    assert np.mean(rates) == pytest.approx(0.4, rel=1e-3)
    for _ in range(3 * STEPS):
        goal.advance()
    assert goal.rate_rad_s == pytest.approx(0.0, abs=1e-12)


def lag_on_a_ramp(feedforward, integral):
    """Lag of a frictionless servo in rad, in the middle of a period, after 4 s at 0.4 rad/s."""
    rig = read_rig("drive").changed(**{
        "servo.velocity_feedforward": feedforward, "servo.position_integral_per_s2": integral,
        "servo.coulomb_friction_nm": 0.0, "servo.viscous_friction_nm_s_rad": 0.0,
        "servo.load_friction_share": 0.0, "servo.velocity_integral_rad_s": 0.0,
        "servo.backlash_rad": 1e3,
    })  # fmt: skip
    structure = msgspec.structs.replace(rig.structure, position_loop="feedforward")
    servo = RigServo(replace(rig, structure=structure), STEP_S)
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


def test_forms_of_the_goal_wait_for_the_dead_time():
    for name in ("default", "drive", "profile"):
        servo = RigServo(read_rig(name).changed(**{"servo.dead_time_s": 0.05}), STEP_S)
        servo.send(0.1, 0.0)
        for k in range(50):
            servo.step(k * STEP_S, 0.0, 0.0)
            assert servo.current_a == 0.0
        for k in range(50, 60):
            servo.step(k * STEP_S, 0.0, 0.0)
        assert servo.current_a > 0.0


@pytest.mark.parametrize(
    "name, steps_early", [("default", 0.0), ("profile", 0.5 * STEPS), ("drive", 0.5 * (STEPS - 1))]
)
def test_the_register_holds_a_ramp_as_late_as_its_sampling_says(name, steps_early):
    """On a ramp of one ampere a step; the mean over the period is as late as its middle."""
    register = CurrentRegister(read_rig(name), STEP_S)
    for k in range(100):
        register.hold(float(k))
    assert 99 - register.value_a == pytest.approx(steps_early, abs=0.5)


def test_the_register_of_a_constant_current_is_that_current():
    for name in ("default", "profile", "drive"):
        register = CurrentRegister(read_rig(name), STEP_S)
        for _ in range(50):
            register.hold(1.25)
        assert register.value_a == pytest.approx(1.25)
