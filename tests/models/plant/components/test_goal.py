"""Goals that a servo holds, interpolates or profiles, against an independent integration."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from models.plant.components.cascade import profiled_change
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names
from models.rig.servo import ProfiledGoal

STEP_S = 0.017
VALUES = {
    "position_gain_1_per_s": 12.0, "velocity_gain_1_a_s_rad": 18.0, "current_limit_1_a": 50.0,
    "velocity_integral_time_1_s": 0.3, "torque_constant_1_nm_a": 6.0, "rotor_inertia_1_kg_m2": 2.0,
    "mass_kg": 1.0, "arm_length_m": 0.1, "gravity_m_s2": 9.81,
}  # fmt: skip
OPTIONS = {"forward": 0.4, "gather": 8.0, "weight": 0.7}
"""Feed-forward, position integral and set-point weight, as arguments of `integrated`."""
EXTENDED = {
    "velocity_feedforward_1": 0.4, "position_integral_1_per_s2": 8.0, "setpoint_weight_1": 0.7,
}  # fmt: skip
SETTLED = slice(60, None)


def sinusoid(count, rad_s=3.0):
    return 0.4 * np.sin(rad_s * STEP_S * np.arange(count))


@pytest.fixture(scope="module")
def pendulum(plant_with):
    return CompiledModel(plant_with("cascade", "pendulum", VALUES).step_model(1))


@pytest.fixture(scope="module")
def extended_pendulum(plant_with):
    return CompiledModel(plant_with("cascade", "pendulum", VALUES | EXTENDED).step_model(1))


def run(compiled, goal, **changes):
    known = {"goal_1_rad": goal, "payload_kg": np.zeros(len(goal))}
    u = np.column_stack([known[name] for name in names(compiled.model.inputs)])
    y = compiled.simulate(u, STEP_S, compiled.model.parameter_values(changes))
    return dict(zip(names(compiled.model.outputs), y.T, strict=True))


def integrated(goal, interpolation, phase=1.0, speed=np.inf, forward=0.0, gather=0.0, weight=1.0):
    """Angle at the end of each step, and current at a phase of it, by an adaptive integration."""
    v, x, before = VALUES, np.zeros(4), goal[0]
    inertia = v["rotor_inertia_1_kg_m2"] + v["mass_kg"] * v["arm_length_m"] ** 2
    weight_nm = v["mass_kg"] * v["gravity_m_s2"] * v["arm_length_m"]
    rows = []
    for sent in goal:
        change = np.clip(sent - before, -speed * STEP_S, speed * STEP_S)

        def current(t, x, before=before, change=change):
            shaped = before + change * (1 - interpolation + interpolation * t / STEP_S)
            lag = shaped - x[0]
            wanted = v["position_gain_1_per_s"] * lag + forward * change / STEP_S + gather * x[3]
            integral = x[2] / v["velocity_integral_time_1_s"]
            current_a = v["velocity_gain_1_a_s_rad"] * (weight * wanted - x[1] + integral)
            return current_a, wanted - x[1], lag

        def rate(t, x, current=current):
            current_a, error, lag = current(t, x)
            torque = v["torque_constant_1_nm_a"] * current_a - weight_nm * np.sin(x[0])
            return [x[1], torque / inertia, error, lag]

        times = np.unique([phase * STEP_S, STEP_S])
        y = solve_ivp(rate, (0, STEP_S), x, rtol=1e-10, atol=1e-12, t_eval=times).y
        rows.append((y[0, -1], current(times[0], y[:, 0])[0]))
        x, before = y[:, -1], before + change
    return np.array(rows).T


def current_errors(current_a, goal, interpolation, phase, **options):
    """RMS error of a current sampled at a phase, and RMS of what the phase changes."""
    late = 0 if phase > 0.0 else 1  # a sample before the jump follows that of the step before
    at_phase = integrated(goal, interpolation, phase + late, **options)[1]
    at_end = integrated(goal, interpolation, **options)[1]
    error = current_a[1 + late :] - at_phase[: len(goal) - late]
    parts = error[SETTLED], (at_phase - at_end)[SETTLED]
    return [np.sqrt(np.mean(part**2)) for part in parts]


@pytest.mark.parametrize("interpolation", [0.0, 0.4])
def test_the_goal_within_a_step_is_that_of_an_independent_integration(pendulum, interpolation):
    goal = sinusoid(200)
    y = run(pendulum, goal, goal_interpolation_1=interpolation)
    angle_rad, current_a = integrated(goal, interpolation)
    np.testing.assert_allclose(y["angle_1_rad"][1:], angle_rad, atol=2e-6)
    np.testing.assert_allclose(y["current_1_a"][1:], current_a, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("interpolation", "phase", "delay_s", "options"),
    [
        (0.0, 0.7, 0.0, {}),
        (0.5, 0.4, 0.0, {}),
        # The sample of a late goal is the earlier one, also before its jump.
        (0.0, 0.9, 0.004, {}),
        (0.0, 0.1, 0.004, {}),
        (0.0, 0.5, 0.0, OPTIONS),
        (1.0, 0.3, 0.0, OPTIONS),
    ],
)
def test_the_current_is_sampled_at_its_phase(
    pendulum, extended_pendulum, interpolation, phase, delay_s, options
):
    """A line between two ends of steps ignores the ripple of a goal whose slope has kinks."""
    goal = sinusoid(300)
    y = run(
        extended_pendulum if options else pendulum, goal,
        goal_interpolation_1=interpolation, current_phase_1=phase, goal_delay_1_s=delay_s,
    )  # fmt: skip
    if options:
        angle_rad, _ = integrated(goal, interpolation, phase, **options)
        np.testing.assert_allclose(y["angle_1_rad"][1:], angle_rad, atol=2e-6)
    sampled = phase - delay_s / STEP_S
    error, moved = current_errors(y["current_1_a"], goal, interpolation, sampled, **options)
    assert error < 0.05 * moved + 0.015 * interpolation


def test_full_feedforward_follows_a_ramp_without_lag_and_none_lags_by_the_gain(
    pendulum, extended_pendulum
):
    ramp = 0.2 * STEP_S * np.arange(250)
    values = {"goal_interpolation_1": 1.0, "gravity_m_s2": 0.0}
    lags = [ramp[-1] - run(pendulum, ramp, **values)["angle_1_rad"][-1]]
    values["position_integral_1_per_s2"] = 0.0
    for forward in (0.5, 1.0):
        y = run(extended_pendulum, ramp, velocity_feedforward_1=forward, **values)
        lags.append(ramp[-1] - y["angle_1_rad"][-1])
    lag = 0.2 / VALUES["position_gain_1_per_s"]
    np.testing.assert_allclose(lags, [lag, 0.5 * lag, 0.0], atol=2e-5)


def test_a_goal_that_takes_effect_late_moves_the_joint_late(pendulum):
    """The joint is 4 mrad late; the goal's curvature within a step, 0.08 mrad, is ignored."""
    goal, delay_s, times_s = sinusoid(200), STEP_S / 5, STEP_S * np.arange(201)
    late, on_time = (run(pendulum, goal, goal_delay_1_s=d)["angle_1_rad"] for d in (delay_s, 0.0))
    expected = CubicSpline(times_s, on_time)(times_s - delay_s)
    np.testing.assert_allclose(late[SETTLED], expected[SETTLED], atol=1e-4)


def test_a_profile_limits_the_speed(pendulum):
    goal = np.where(np.arange(150) < 10, 0.0, 0.3)
    y = run(pendulum, goal, goal_interpolation_1=1.0, profile_speed_1_rad_s=0.5)
    angle_rad, _ = integrated(goal, 1.0, speed=0.5)
    np.testing.assert_allclose(y["angle_1_rad"][1:], angle_rad, atol=2e-6)


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


def jumping_goals(seed):
    """A sinusoid with jumps to either side, some before the last one is finished."""
    jumps = np.repeat(np.random.default_rng(seed).normal(0, 0.1, 20), 15)
    return 0.5 * np.sin(1.45 * STEP_S * np.arange(300)) + jumps


@pytest.mark.parametrize("speed, acceleration", [(100.0, 12.0), (0.6, 12.0)])
def test_the_profile_is_that_of_an_integration_in_small_steps(profile, speed, acceleration):
    goals, per_step = jumping_goals(0), 500
    fine = ProfiledGoal(STEP_S / per_step, speed, acceleration)
    expected = []
    for goal in goals:
        fine.take(goal)
        for _ in range(per_step):
            at = fine.advance()
        expected.append(at)
    fastest = np.sqrt(acceleration)  # of 1 rad; the small steps are late by about one of them
    angle_rad, _ = set_point(profile, goals, speed, acceleration)
    np.testing.assert_allclose(angle_rad, expected, atol=2 * fastest * STEP_S / per_step)
