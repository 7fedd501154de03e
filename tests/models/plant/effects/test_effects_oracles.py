"""Effects against independent calculations: scipy's filters and integrators, closed forms."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.signal import lfilter

from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

FINE_S = 1e-3
CONSTANT_NM_A = 6.83


def fine_run(plant, changes=None, step_rad=0.0):
    """Outputs of a twin by name each millisecond; with a step its goal is a coarse staircase."""
    model = plant.step_model(1)
    time_s = FINE_S * np.arange(2500)
    goal = 0.1 * np.sin(3 * time_s)
    goal = step_rad * np.round(goal / step_rad) if step_rad else goal
    u = np.column_stack([goal, np.ones(len(time_s))])
    y = CompiledModel(model).simulate(u, FINE_S, model.parameter_values(changes or {}))
    return dict(zip(names(model.outputs), y.T, strict=True))


def low_pass(signal, time_s):
    """First-order low-pass of samples, by the bilinear rule, at rest before them."""
    pole = (2 * time_s / FINE_S - 1) / (2 * time_s / FINE_S + 1)
    gain = (1 - pole) / 2
    return lfilter([gain, gain], [1, -pole], signal - signal[0]) + signal[0]


def stribeck_torque_nm(plant, angle_rad, step_s, strength_nm):
    """Torque of a Stribeck friction on a driven course, by the current that it takes."""
    model = CompiledModel(plant.step_model(1, "driven"))
    u = np.column_stack([angle_rad, np.zeros(len(angle_rad))])
    column = names(model.model.outputs).index("current_1_a")
    plain, extra = (
        model.simulate(
            u, step_s, model.model.parameter_values({"stribeck_friction_1_nm": strength})
        )[1:, column]
        for strength in (0.0, strength_nm)
    )
    return 6.83 * (extra - plain)


def test_stribeck_friction_builds_up_over_its_distance_after_a_reversal(bench):
    """Slower than it fades, b = 1 - 2 exp(-s/δ) at the distance s from the reversal."""
    step_s, rate_rad_s, distance_rad = 0.001, 0.1, 0.01
    plant = bench.plant("stribeck_friction").with_values(
        {"stribeck_speed_1_rad_s": 1.0, "stribeck_distance_1_rad": distance_rad}
    )
    travelled = rate_rad_s * step_s * np.arange(1200)
    angle = np.where(travelled < 0.06, travelled, 0.12 - travelled)
    torque = stribeck_torque_nm(plant, angle, step_s, 4.0)
    back = travelled - 0.06
    sliding = back > 0.2 * distance_rad
    expected = -4.0 * (1 - 2 * np.exp(-back[sliding] / distance_rad))
    assert torque[sliding] == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize(
    ("tail", "law"),
    [(0.02, lambda r: np.exp(-(r**2))), (1.0, lambda r: 1 / (1 + (math.e - 1) * r**2))],
    ids=["gaussian", "rational"],
)
def test_stribeck_friction_fades_by_the_laws_of_the_literature(bench, tail, law):
    """Bo and Pavelescu with next to no tail, Hess and Soom with tail 1."""
    step_s, speed_rad_s = 0.001, 1.0
    plant = bench.plant("stribeck_friction").with_values(
        {"stribeck_speed_1_rad_s": speed_rad_s, "stribeck_tail_1": tail}
    )
    rate = 4.0 * np.arange(1, 1001) * step_s
    torque = stribeck_torque_nm(plant, np.cumsum(rate) * step_s, step_s, 4.0)
    sliding = rate > 0.08  # beyond the smooth sign
    expected = 4.0 * law(rate[sliding] / speed_rad_s)
    assert torque[sliding] == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_sensor_lag_is_a_low_pass_of_the_current_alone(bench, share):
    """Of first order, or of two equal stages where the document gives the second a fraction.

    A step of the goal makes the current jump by 4 A between two samples; the rule misses half a
    sample of it, 0.03 A.
    """
    lag_s = 0.08
    plant = bench.plant("sensor_lag").with_values({"sensor_lag_second_1": share})
    before, after = (fine_run(plant, c, 0.02) for c in ({}, {"sensor_lag_1_s": lag_s}))
    expected = low_pass(before["current_1_a"], (1 - share) * lag_s)
    if share:
        expected = low_pass(expected, share * lag_s)
    changed = np.abs(after["current_1_a"] - before["current_1_a"]).max()
    assert np.abs(after["current_1_a"] - expected).max() < 0.02 * changed
    for name in before.keys() - {"current_1_a"}:
        assert np.array_equal(before[name], after[name]), name


def test_a_lag_takes_the_saw_tooth_of_a_held_goal_away_and_its_jump_gives_it_back(bench):
    """On a steady ramp a low-pass leaves the mean of the current, above its sample at the end.

    The mean of a saw-tooth that decays by exp(-t/τ) is τ/h - r/(1 - r) jumps above its end,
    r = exp(-h/τ). τ is that of the velocity loop against all inertia, here of the rotor; the link's
    own changes it little, as its joint is soft.
    """
    step_s, rate_rad_s, lag_s = 0.017, 0.2, 0.05
    plant = bench.plant("sensor_lag")
    known = {name: q.value for name, q in plant.parameters.items()}
    decay_s = known["rotor_inertia_1_kg_m2"] / (CONSTANT_NM_A * known["velocity_gain_1_a_s_rad"])
    left = np.exp(-step_s / decay_s)
    above = decay_s / step_s - left / (1 - left)
    change_a = (
        known["velocity_gain_1_a_s_rad"] * known["position_gain_1_per_s"] * rate_rad_s * step_s
    )
    model = CompiledModel(plant.step_model(1))
    goal = rate_rad_s * step_s * np.arange(-150, 150)
    column = names(model.model.outputs).index("current_1_a")

    def current_a(**changes):
        u = np.column_stack([goal, np.zeros(len(goal))])
        return model.simulate(u, step_s, model.model.parameter_values(changes))[100:, column]

    sampled, lagged = current_a(), current_a(sensor_lag_1_s=lag_s)
    restored = current_a(sensor_lag_1_s=lag_s, sensor_lag_jump_1=-above)
    assert np.mean(lagged - sampled) == pytest.approx(above * change_a, rel=0.1)
    assert abs(np.mean(restored - sampled)) < 0.1 * above * change_a


def test_behind_a_lag_it_does_not_matter_when_the_saw_tooth_is_sampled(bench):
    """A low-pass of three steps leaves the mean of the current, at whatever phase it is read."""
    step_s, rate_rad_s = 0.017, 0.2
    model = CompiledModel(bench.plant("sensor_lag").step_model(1))
    goal = rate_rad_s * step_s * np.arange(-150, 150)
    u = np.column_stack([goal, np.zeros(len(goal))])
    column = names(model.model.outputs).index("current_1_a")

    def mean_current_a(phase, lag_s):
        changes = {"current_phase_1": phase, "sensor_lag_1_s": lag_s}
        values = model.model.parameter_values(changes)
        return model.simulate(u, step_s, values)[100:, column].mean()

    sampled = [mean_current_a(phase, 0.0) for phase in (0.1, 0.5, 1.0)]
    lagged = [mean_current_a(phase, 0.05) for phase in (0.1, 0.5, 1.0)]
    assert np.ptp(sampled) > 0.1
    assert np.ptp(lagged) < 0.01 * np.ptp(sampled)


def test_the_jump_of_a_lag_is_viscous_friction_in_the_current_alone(bench):
    """A plant that errs in its saw-tooth has made up for it by viscous friction."""
    lag_s, jump = 0.05, 0.4
    plant = bench.plant("sensor_lag")
    known = {name: q.value for name, q in plant.parameters.items()}
    before = fine_run(plant, {"sensor_lag_1_s": lag_s})
    after = fine_run(plant, {"sensor_lag_1_s": lag_s, "sensor_lag_jump_1": jump})
    rate = np.gradient(before["angle_1_rad"], FINE_S)
    per_rate = known["velocity_gain_1_a_s_rad"] * known["position_gain_1_per_s"] * FINE_S
    expected = low_pass(jump * per_rate * rate, lag_s)
    error = np.abs(after["current_1_a"] - before["current_1_a"] - expected)
    assert error.max() < 0.02 * np.abs(expected).max()
    assert np.array_equal(before["angle_1_rad"], after["angle_1_rad"])


def test_the_lags_of_angle_and_mocap_delay_slow_signals(bench):
    lag_s = 0.02
    plant = bench.plant("sensor_lag")
    before = fine_run(plant)
    for name, outputs in (
        ("sensor_lag_angle_1_s", ["angle_1_rad"]),
        ("sensor_lag_mocap_s", ["tip_x_m"]),
    ):
        after = fine_run(plant, {name: lag_s})
        for output in outputs:
            expected = low_pass(before[output], lag_s)[500:]
            error = np.abs(after[output][500:] - expected).max()
            assert error < 0.05 * np.abs(before[output][500:] - expected).max(), output
        assert np.array_equal(after["current_1_a"], before["current_1_a"])


def test_the_servo_puts_a_rippled_reading_on_its_goal(bench):
    """The joint then stands where the reading is the goal: a root of q + a sin nq + b cos nq."""
    goal, sine, cosine, order = 0.31, 0.006, -0.004, 16.0

    def reading(q):
        return q + sine * np.sin(order * q) + cosine * np.cos(order * q)

    true = brentq(lambda q: reading(q) - goal, goal - 0.02, goal + 0.02)
    changes = {"encoder_ripple_1_rad": sine, "encoder_ripple_cosine_1_rad": cosine}
    held = np.full(200, goal)
    seen = bench.run(["encoder_ripple"], changes, goal=held, count=200)
    plain = bench.run(["encoder_ripple"], goal=np.full(200, true), count=200)
    assert abs(true - goal) > 1e-3
    assert seen["angle_1_rad"] == pytest.approx(held[0], abs=2e-6)
    assert seen["tip_x_m"][-1] == pytest.approx(plain["tip_x_m"][-1], abs=2e-6)
    assert np.ptp(seen["tip_x_m"]) < 1e-5, "it starts at rest"


def test_marker_scale_scales_the_tip_and_not_the_index(bench):
    before, after = (bench.run(["marker_scale"], c) for c in ({}, {"marker_scale": 0.02}))
    for axis in "xyz":
        assert after[f"tip_{axis}_m"] == pytest.approx(1.02 * before[f"tip_{axis}_m"], abs=1e-12)
    for name in ("angle_1_rad", "current_1_a", "di"):
        assert np.array_equal(before[name], after[name])


def driven_torque(bench, effect, changes, angle):
    """Extra torque that a joint needs which moves as given, and its coordinate."""
    runs = [
        bench.run([effect], c, kind="driven", goal=angle, count=len(angle)) for c in ({}, changes)
    ]
    return CONSTANT_NM_A * (runs[1]["current_1_a"] - runs[0]["current_1_a"])[1:]


def test_cogging_takes_no_energy_over_its_period(bench):
    """A slow turn over whole periods of 24 a turn; the filter of the angle lags by 17 ms."""
    period, rate, lag_s = 2 * np.pi / 24, 0.1, 2 / 120
    angle = np.arange(0, 2.5 * period, rate * bench.step_s)
    changes = {"cogging_1_nm": 1.5, "cogging_cosine_1_nm": -0.7}
    torque = driven_torque(bench, "cogging", changes, angle)
    expected = 1.5 * np.sin(24 * angle) - 0.7 * np.cos(24 * angle)
    count = round(period / (rate * bench.step_s))
    settled = slice(len(torque) - count, None)
    assert lag_s * rate * 24 < 0.05
    assert torque[settled] == pytest.approx(expected[settled], abs=0.08)
    energy = torque[settled].sum() * rate * bench.step_s
    assert abs(energy) < 0.02 * np.abs(torque[settled]).sum() * rate * bench.step_s


def test_stiction_is_lost_over_a_distance_and_regained_at_rest(bench):
    """Break away, stop briefly, go on, rest, go on, turn round; memory by scipy's integrator."""
    force_nm, distance, dwell_s, rate = 4.0, 0.02, 2.0, 0.15
    legs = [(1.0, 0), (1.5, 1), (0.05, 0), (1.0, 1), (3.0, 0), (1.5, 1), (1.5, -1)]
    rates = np.concatenate([np.full(round(s / bench.step_s), d * rate) for s, d in legs])
    angle = np.cumsum(rates) * bench.step_s
    changes = {"stiction_1_nm": force_nm, "stiction_distance_1_rad": distance,
               "stiction_dwell_1_s": dwell_s}  # fmt: skip
    torque = driven_torque(bench, "stiction", changes, angle)

    def memory(t, x):
        w = rates[min(int(t / bench.step_s), len(rates) - 1)]
        return (w - abs(w) * x) / (distance + abs(w) * 2e-3) - x / dwell_s

    time_s = bench.step_s * np.arange(1, len(rates) + 1)
    x = solve_ivp(memory, (0, time_s[-1]), [0.0], t_eval=time_s, max_step=2e-3).y[0]
    expected = force_nm * (1 - x**2) * np.tanh(rates / 0.02)
    start = np.cumsum([round(s / bench.step_s) for s, _ in legs])
    moving = np.abs(rates) > 0
    for k in start:  # the filter of the angle rounds each corner off
        moving[max(k - 2, 0) : k + 5] = False
    assert torque[moving] == pytest.approx(expected[moving], abs=0.06 * force_nm)
    peak = [np.abs(torque[a:b]).max() for a, b in itertools.pairwise(start)]
    away, _, briefly, _, rested, turned = peak
    assert away > 0.7 * force_nm and rested > 0.7 * force_nm and turned > 0.9 * force_nm
    assert briefly < 0.3 * force_nm
    assert np.abs(torque[start[5] - 20 : start[5] - 2]).max() < 0.2 * force_nm, (
        "little before a stop"
    )


def test_a_mass_slides_once_the_breakaway_force_is_exceeded(tmp_path):
    """A force that rises slowly: creep within the smooth sign's speed before, a run after."""
    path = tmp_path / "plant.toml"
    path.write_text(
        'schema = 1\nname = "p"\ndrive = { kind = "force" }\nload = { kind = "mass" }\n'
        'effects = [{ name = "stiction" }]\n[parameters]\nstiction_1_n = 30.0\nmass_kg = 95.0\n'
        "friction_speed_1_m_s = 1e-4\nforce_constant_1_n_v = 10.0\n"
    )
    model = read_plant(path).step_model(1)
    force_n = np.linspace(0.0, 40.0, 400)
    u = np.zeros((len(force_n), len(model.inputs)))
    u[:, names(model.inputs).index("command_1_v")] = force_n / 10.0
    position = CompiledModel(model).simulate(u, 0.005)[1:, 0]
    before, after = position[force_n < 27.0][-1], position[-1]
    assert before < 5e-4 < 1e-2 < after
