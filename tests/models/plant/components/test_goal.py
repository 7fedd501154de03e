"""Goals held, interpolated and profiled, against an independent integration of the cascade."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicSpline

from models.plant.components.cascade import Cascade
from models.plant.components.drive import declare_goal
from models.plant.components.goal import NO_ACCELERATION_LIMIT, above_mean, profiled_change
from models.plant.components.link import Link
from models.plant.compose import compose_twin
from models.plant.identification.fit import Objective, fit_objective
from models.plant.plant import read_plant
from models.plant.scope import CurrentSampling, Scope
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import Variable, names
from models.rig.servo import ProfiledGoal

STEP_S = 0.017
VALUES = {
    "position_gain_1_per_s": 12.0, "velocity_gain_1_a_s_rad": 18.0, "current_limit_1_a": 50.0,
    "velocity_integral_time_1_s": 0.3, "torque_constant_1_nm_a": 6.0, "rotor_inertia_1_kg_m2": 2.0,
    "mass_kg": 1.0, "arm_length_m": 0.1, "gravity_m_s2": 9.81,
}  # fmt: skip
VALUES_TOML = "\n".join(f"{name} = {value}" for name, value in VALUES.items())
EXTENSION = {"forward": 0.4, "gather": 8.0, "weight": 0.7}
EXTENDED = ("velocity_feedforward_1", "position_integral_1_per_s2", "setpoint_weight_1")
"""Arguments of `integrated`, and the plant's parameters."""

DOCUMENT = f"""
schema = 1
name = "pendulum on a cascade"
drive = {{ kind = "cascade" }}
load = {{ kind = "pendulum" }}
[parameters]
{VALUES_TOML}
"""


def sinusoid(count, rad_s=3.0):
    return 0.4 * np.sin(rad_s * STEP_S * np.arange(count))


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    path = tmp_path_factory.mktemp("plant") / "pendulum.toml"
    path.write_text(DOCUMENT)
    return CompiledModel(read_plant(path).step_model(1, "twin"))


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


@pytest.mark.parametrize("interpolation", [0.0, 0.4, 1.0])
def test_the_goal_within_a_step_is_the_one_of_an_independent_integration(pendulum, interpolation):
    goal = sinusoid(200)
    y = run(pendulum, goal, goal_interpolation_1=interpolation)
    angle_rad, current_a = integrated(goal, interpolation)
    np.testing.assert_allclose(y["angle_1_rad"][1:], angle_rad, atol=2e-6)
    np.testing.assert_allclose(y["current_1_a"][1:], current_a, atol=2e-3)


@pytest.fixture(scope="module")
def forward_pendulum(tmp_path_factory):
    """With what a plant has only where it is not fixed at zero."""
    path = tmp_path_factory.mktemp("plant") / "pendulum.toml"
    path.write_text(DOCUMENT)
    extended = dict(zip(EXTENDED, EXTENSION.values(), strict=True))
    return CompiledModel(read_plant(path).with_values(VALUES | extended).step_model(1, "twin"))


@pytest.mark.parametrize("interpolation, phase", [(0.0, 1.0), (1.0, 1.0), (0.0, 0.5), (1.0, 0.3)])
def test_feedforward_position_integral_and_weight_are_those_of_an_independent_integration(
    forward_pendulum, interpolation, phase
):
    goal = sinusoid(300)
    y = run(forward_pendulum, goal, goal_interpolation_1=interpolation, current_phase_1=phase)
    angle_rad, at_phase = integrated(goal, interpolation, phase, **EXTENSION)
    _, at_end = integrated(goal, interpolation, **EXTENSION)
    np.testing.assert_allclose(y["angle_1_rad"][1:], angle_rad, atol=2e-6)
    settled = slice(60, None)
    error = (y["current_1_a"][1:] - at_phase)[settled]
    moved = (at_phase - at_end)[settled]
    ripple_a = 1e-3 if phase == 1.0 else 0.015 * interpolation
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(moved**2)) + ripple_a


def test_full_feedforward_follows_a_ramp_without_lag_and_none_lags_by_the_gain(
    pendulum, forward_pendulum
):
    ramp = 0.2 * STEP_S * np.arange(250)
    values = {"goal_interpolation_1": 1.0, "gravity_m_s2": 0.0}
    without = run(pendulum, ramp, **values)["angle_1_rad"][-1]
    half = run(forward_pendulum, ramp, velocity_feedforward_1=0.5,
               position_integral_1_per_s2=0.0, **values)["angle_1_rad"][-1]  # fmt: skip
    full = run(forward_pendulum, ramp, velocity_feedforward_1=1.0,
               position_integral_1_per_s2=0.0, **values)["angle_1_rad"][-1]  # fmt: skip
    lag = 0.2 / VALUES["position_gain_1_per_s"]
    lags = ramp[-1] - np.array([without, half, full])
    np.testing.assert_allclose(lags, [lag, 0.5 * lag, 0.0], atol=2e-5)


@pytest.mark.parametrize("interpolation", [0.0, 1.0])
def test_a_goal_that_takes_effect_late_moves_the_joint_late(pendulum, interpolation):
    """The joint is 4 mrad late; the goal's curvature within a step is left out, 0.08 mrad."""
    goal, delay_s = sinusoid(200), STEP_S / 5
    y = run(pendulum, goal, goal_interpolation_1=interpolation, goal_delay_1_s=delay_s)
    on_time = run(pendulum, goal, goal_interpolation_1=interpolation)
    settled = slice(60, 200)
    times_s = STEP_S * np.arange(201)
    expected = CubicSpline(times_s, on_time["angle_1_rad"])(times_s - delay_s)
    np.testing.assert_allclose(y["angle_1_rad"][settled], expected[settled], atol=1e-4)


@pytest.mark.parametrize("phase, delay_s", [(0.9, 0.004), (0.3, 0.01), (0.1, 0.004)])
def test_the_current_of_a_late_goal_is_the_earlier_one_also_before_its_jump(
    pendulum, phase, delay_s
):
    goal = sinusoid(300)
    y = run(pendulum, goal, current_phase_1=phase, goal_delay_1_s=delay_s)
    earlier = phase - delay_s / STEP_S
    steps_before = 0 if earlier > 0.0 else 1
    _, at_phase = integrated(goal, 0.0, earlier + steps_before)
    _, at_end = integrated(goal, 0.0)
    settled = slice(60, None)
    error = (y["current_1_a"][1 + steps_before :] - at_phase[: 300 - steps_before])[settled]
    moved = (at_phase - at_end)[settled]
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(moved**2))


@pytest.mark.parametrize("interpolation, phase", [(0.0, 0.7), (0.0, 0.4), (0.5, 0.4), (1.0, 0.2)])
def test_the_current_is_sampled_at_its_phase(pendulum, interpolation, phase):
    """A line between two ends of steps leaves out the ripple of a goal whose slope has kinks."""
    goal = sinusoid(300)
    y = run(pendulum, goal, goal_interpolation_1=interpolation, current_phase_1=phase)
    _, at_phase = integrated(goal, interpolation, phase)
    _, at_end = integrated(goal, interpolation)
    settled = slice(60, None)
    error = (y["current_1_a"][1:] - at_phase)[settled]
    moved = (at_phase - at_end)[settled]
    ripple_a = 0.015 * interpolation
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(moved**2)) + ripple_a


def test_a_profile_limits_the_speed_and_reaches_the_goal_without_overshoot(pendulum):
    speed = 0.5
    goal = np.where(np.arange(150) < 10, 0.0, 0.3)
    y = run(pendulum, goal, goal_interpolation_1=1.0, profile_speed_1_rad_s=speed)
    angle_rad, _ = integrated(goal, 1.0, speed=speed)
    np.testing.assert_allclose(y["angle_1_rad"][1:], angle_rad, atol=2e-6)
    index = names(pendulum.model.states).index("shaped_goal_1_rad")
    model = pendulum.model
    p = model.parameter_values({"goal_interpolation_1": 1.0, "profile_speed_1_rad_s": speed})
    x = np.asarray(model.initial([0.0, 0.0], p)).ravel()
    shaped = []
    for value in goal:
        x = model.advance(x, np.array([value, 0.0]), p, STEP_S)
        shaped.append(x[index])
    steps = np.diff(shaped)
    assert np.all(steps >= -1e-12) and np.all(steps <= speed * STEP_S + 1e-12)
    assert shaped[-1] == pytest.approx(0.3, abs=1e-12)


class HeldCascade(Cascade):
    """The cascade with its goal as an input that is held: the equations without a shape."""

    def declare(self, scope):
        for j in scope.joints:
            declare_goal(scope, j)
            scope.sampling[j] = CurrentSampling(0, None)
            scope.state(Variable(f"velocity_integral_{j}_rad", "rad", nominal=0.01))


def test_the_defaults_are_the_cascade_without_a_shape():
    nominal = read_plant()
    outputs = []
    for drive in (Cascade(), HeldCascade()):
        scope = Scope((1, 2))
        declared = [*drive.parameters(scope), *Link().parameters(scope)]
        scope.declare([nominal.parameters[q.name] for q in declared])
        model = compose_twin("twin", scope, drive, Link(), [])
        goal = sinusoid(200)
        u = np.column_stack([goal, 0.7 * goal, np.ones(200)])
        outputs.append(CompiledModel(model).simulate(u, STEP_S))
    np.testing.assert_allclose(outputs[0], outputs[1], rtol=1e-12, atol=1e-12)


def test_the_sawtooth_has_no_mean_over_the_phases():
    symbols = [ca.SX.sym(name) for name in ("phase", "step_s", "decay_s")]
    above = ca.Function("above", symbols, [above_mean(*symbols)])
    for decay in (0.002, 0.007, 0.03):
        mean = quad(lambda at, tau=decay: float(above(at, STEP_S, tau)), 0.0, 1.0)[0]
        assert mean == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("interpolation, phase", [(0.7, 0.5), (0.1, 0.8)])
def test_interpolation_and_phase_come_back_from_noisy_runs(synthetic, interpolation, phase):
    shape = {"goal_interpolation_1": interpolation, "current_phase_1": phase}
    true = read_plant().with_values(shape)
    rng = np.random.default_rng(3)
    trials = [synthetic(true, load, count=330, rng=rng) for load in (0.0, 2.0)]
    start = read_plant().with_values({"position_gain_1_per_s": 10.0})
    free = (*shape, "position_gain_1_per_s", "viscous_friction_1_nm_s_rad")
    scale = {"angle_1_rad": 1e-4}
    found = fit_objective(Objective(start, "twin", trials, free, ("angle", "current"), scale))
    q = found.plant.parameters
    assert q["goal_interpolation_1"].value == pytest.approx(interpolation, abs=0.05)
    assert q["current_phase_1"].value == pytest.approx(phase, abs=0.1)
    assert q["position_gain_1_per_s"].value == pytest.approx(12.0, rel=0.01)


def test_a_file_without_a_shape_reads_as_one_that_holds_its_goals(tmp_path):
    nominal = read_plant()
    shape = {
        n for n in nominal.parameters
        if "interpolation" in n or "phase" in n or "goal_delay" in n or "acceleration" in n
    }  # fmt: skip
    older = replace(
        nominal, parameters={n: q for n, q in nominal.parameters.items() if n not in shape}
    )
    older.write(tmp_path / "older.json")
    read = read_plant(tmp_path / "older.json").parameters
    default = {"phase": 1.0, "acceleration": NO_ACCELERATION_LIMIT}
    for name in shape:
        expected = next((v for part, v in default.items() if part in name), 0.0)
        assert read[name].value == expected, name


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
