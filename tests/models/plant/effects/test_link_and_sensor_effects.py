"""Effects of the link's bending and of the sensors: what they change, and what they do not."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

FINE_S = 1e-3
TORQUE_CONSTANT_NM_A = 6.83
STILL = np.zeros(300)
LEANING = np.full(700, 0.4)


# --- bend -----------------------------------------------------------------------------------------


def test_prebend_leans_the_unloaded_link(bench):
    bent, other = (
        bench.run(["prebend"], {"prebend_1_rad": bend}, goal=STILL, payload_kg=0.0)["tip_x_m"][-1]
        for bend in (0.03, -0.03)
    )
    evenly_m = 0.03 * 0.95 / 2  # the weight of the link bends it a little further
    assert evenly_m < bent < 1.2 * evenly_m
    assert bent == pytest.approx(-other, rel=1e-9)


def sag_m(bench, effects, changes, goal=LEANING, at=-1):
    """How far the tip hangs below a rigid link's, across it."""
    run = bench.run(effects, changes, goal=goal, count=len(goal))
    angle = run["angle_1_rad"][at]
    return run["tip_x_m"][at] * np.cos(angle) - run["tip_z_m"][at] * np.sin(angle)


def test_stiffness_depends_on_side_size_and_time(bench):
    plain = {s: sag_m(bench, [], {}, s * LEANING) for s in (-1, 1)}
    assert plain[1] == pytest.approx(-plain[-1], rel=1e-9)
    side = {"directional_stiffness_1": 0.2}
    assert sag_m(bench, ["directional_stiffness"], side, LEANING) < 0.95 * plain[1]
    assert sag_m(bench, ["directional_stiffness"], side, -LEANING) < 1.05 * plain[-1] < 0
    assert sag_m(bench, ["stiffness_softening"], {"softening_share": 0.3}) > 1.05 * plain[1]
    assert sag_m(bench, ["stiffness_hardening"], {"hardening_share": 3.0}) < 0.95 * plain[1]
    leak = {"leak_share": 0.2}
    early, late = (sag_m(bench, ["pressure_leak"], leak, at=k) for k in (240, 690))
    assert plain[1] < early < late
    steady = [sag_m(bench, [], {}, at=k) for k in (480, 690)]
    assert abs(steady[1] - steady[0]) < 0.02 * (late - early)


def test_creep_relaxes_and_hysteresis_remembers(bench):
    # Far from its limit moment, at which the jump of the goal would fold the link.
    creep = {"creep_share_1": 0.3, "creep_time_s": 2.0, "root_limit_moment_nm": 80.0}
    up = np.r_[np.zeros(40), np.full(660, 0.4)]
    soon, late = (sag_m(bench, ["creep"], creep, up, at=k) for k in (240, 690))
    assert late > soon + 1e-3
    slow = 0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, 900))  # so that nothing is shaken loose
    there_and_back = {s: 0.3 + s * 0.3 * np.r_[slow, np.zeros(600)] for s in (-1, 1)}
    share = {"hysteresis_share_1": 0.5}
    rest = {s: sag_m(bench, ["hysteresis"], share, g) for s, g in there_and_back.items()}
    plain = {s: sag_m(bench, [], {}, g) for s, g in there_and_back.items()}
    assert abs(plain[1] - plain[-1]) < 1e-5 < 5e-4 < rest[1] - rest[-1]


@pytest.mark.parametrize("dof", [1, 2])
def test_coupling_bends_across(bench, dof):
    """A link of one joint bends across its plane by the share of its sag, more by its weight."""
    goal = np.full(600, 0.3)
    x, y = {}, {}
    for share in (-0.2, 0.0, 0.2):
        changes = {"coupling_share": share}
        run = bench.run(["cross_axis_coupling"], changes, dof=dof, goal=goal, count=600)
        x[share], y[share] = run["tip_x_m"][-1], run["tip_y_m"][-1]
    if dof == 2:
        assert x[0.2] != pytest.approx(x[-0.2], abs=1e-3)
        return
    stiff = bench.run([], {"root_stiffness_1_nm_rad": 1000.0, "span_stiffness_1_nm_rad": 1200.0},
                      goal=goal, count=600)  # fmt: skip
    sag = x[0.0] - stiff["tip_x_m"][-1]
    assert y[0.0] == pytest.approx(0.0, abs=1e-9)
    assert y[0.2] == pytest.approx(-y[-0.2], rel=1e-6)
    assert 0.2 * sag < abs(y[0.2]) < 0.5 * sag
    assert x[0.2] == pytest.approx(x[-0.2], abs=1e-9)


def test_a_link_with_a_soft_side_starts_at_rest(bench):
    """Its stiffness at a bend is not that of the straight link."""
    changes = {"directional_stiffness_1": 0.3, "payload_offset_share": 0.05}
    effects = ["directional_stiffness", "payload_offset"]
    run = bench.run(effects, changes, goal=STILL, payload_kg=2.0)
    assert abs(run["tip_x_m"][0]) > 0.002
    assert np.ptp(run["tip_x_m"]) < 1e-5


# --- encoder and current --------------------------------------------------------------------------


def test_encoder_offset_turns_the_link_and_hides_itself(bench):
    offset = {"encoder_offset_1_rad": 0.05}
    run = bench.run(["encoder_offset"], offset, goal=np.full(600, 0.05), count=600)
    assert run["angle_1_rad"][-1] == pytest.approx(0.05, abs=1e-6)
    assert run["tip_x_m"][-1] == pytest.approx(0.0, abs=1e-6)  # the servo stands upright


@pytest.mark.parametrize("effects", [["encoder_offset"], ["encoder_offset", "prebend"]])
def test_the_index_is_that_of_noise_where_the_encoder_shows_upright(bench, effects):
    """Its reference is the link at rest, bent by the payload that the offset lets lean."""
    changes = dict.fromkeys((f"{e}_1_rad" for e in effects), 0.05)
    straight, leaning = (bench.run(effects, c, goal=STILL, payload_kg=2.0) for c in ({}, changes))
    assert abs(leaning["tip_x_m"][-1]) > 0.02
    assert leaning["di"] == pytest.approx(straight["di"], abs=1e-5)


def test_the_servo_puts_a_rippled_reading_on_its_goal(bench):
    """The joint then stands where the reading is the goal: a root of q + a sin nq + b cos nq."""
    goal, sine, cosine, order = 0.31, 0.006, -0.004, 16.0

    def excess(q):
        return q + sine * np.sin(order * q) + cosine * np.cos(order * q) - goal

    true = brentq(excess, goal - 0.02, goal + 0.02)
    changes = {"encoder_ripple_1_rad": sine, "encoder_ripple_cosine_1_rad": cosine}
    rippled = bench.run(["encoder_ripple"], changes, goal=np.full(200, goal), count=200)
    plain = bench.run(["encoder_ripple"], goal=np.full(200, true), count=200)
    assert abs(true - goal) > 1e-3
    assert rippled["angle_1_rad"] == pytest.approx(goal, abs=2e-6)
    assert rippled["tip_x_m"][-1] == pytest.approx(plain["tip_x_m"][-1], abs=2e-6)
    assert np.ptp(rippled["tip_x_m"]) < 1e-5, "it starts at rest"


def test_current_errors_change_the_current_alone(bench):
    effects, changes = ["current_bias", "current_scale"], {"current_bias_1_a": 0.3,
                                                           "current_scale_1": 0.1}  # fmt: skip
    before, after = (bench.run(effects, c) for c in ({}, changes))
    assert after["current_1_a"] == pytest.approx(1.1 * before["current_1_a"] + 0.3, abs=1e-12)
    for name in before.keys() - {"current_1_a"}:
        assert np.array_equal(before[name], after[name]), name


# --- motion capture -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effect", "changes"),
    [
        ("marker_frame_tilt", {"marker_frame_tilt_rad": 0.1, "marker_frame_roll_rad": 0.05,
                               "marker_frame_yaw_rad": -0.2}),
        ("marker_scale", {"marker_scale": 0.02}),
    ],
)  # fmt: skip
def test_a_turned_or_scaled_frame_moves_the_tip_alone(bench, effect, changes):
    before, after = (bench.run([effect], c) for c in ({}, changes))
    tips = [np.column_stack([run[f"tip_{axis}_m"] for axis in "xyz"]) for run in (before, after)]
    yaw, roll, tilt = (changes.get(f"marker_frame_{n}_rad", 0.0) for n in ("yaw", "roll", "tilt"))
    expected = Rotation.from_euler("zxy", [yaw, roll, tilt]).apply(tips[0])
    assert (1 + changes.get("marker_scale", 0.0)) * expected == pytest.approx(tips[1], abs=1e-12)
    for name in ("angle_1_rad", "current_1_a", "di"):
        assert np.array_equal(before[name], after[name])


@pytest.mark.parametrize("delay_s", [0.034, -0.034])
def test_sync_offset_delays_the_mocap_alone(bench, delay_s):
    """Two ticks: the mocap shows what was, or will be, two rows away."""
    before, after = (bench.run(["sync_offset"], {"sync_offset_s": s}) for s in (0.0, delay_s))
    for name in ("angle_1_rad", "current_1_a"):
        assert np.array_equal(before[name], after[name])
    true, shown = before["tip_x_m"], after["tip_x_m"]
    error = (shown - np.roll(true, round(delay_s / bench.step_s)))[100:-100]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean((shown - true)[100:-100] ** 2))
    assert not np.array_equal(before["di"], after["di"])


# --- lag ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lagged(bench):
    return CompiledModel(bench.plant("sensor_lag").step_model(1))


def fine_run(lagged, step_rad=0.0, **changes):
    """Outputs by name each millisecond; with a step the goal is a coarse staircase."""
    goal = 0.1 * np.sin(3 * FINE_S * np.arange(2500))
    goal = step_rad * np.round(goal / step_rad) if step_rad else goal
    u = np.column_stack([goal, np.ones(len(goal))])
    y = lagged.simulate(u, FINE_S, lagged.model.parameter_values(changes))
    return dict(zip(names(lagged.model.outputs), y.T, strict=True))


def low_pass(signal, time_s):
    """First-order low-pass of samples, by the bilinear rule, at rest before them."""
    pole = (2 * time_s / FINE_S - 1) / (2 * time_s / FINE_S + 1)
    gain = (1 - pole) / 2
    return lfilter([gain, gain], [1, -pole], signal - signal[0]) + signal[0]


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_sensor_lag_is_a_low_pass_of_the_current_alone(bench, share):
    """Of first order, or of two equal stages where the document gives the second a fraction.

    A step of the goal makes the current jump by 4 A between two samples; the rule misses half a
    sample of it, 0.03 A.
    """
    plant, lag_s = bench.plant("sensor_lag").with_values({"sensor_lag_second_1": share}), 0.08
    model = CompiledModel(plant.step_model(1))
    before, after = (fine_run(model, 0.02, sensor_lag_1_s=s) for s in (0.0, lag_s))
    expected = low_pass(before["current_1_a"], (1 - share) * lag_s)
    if share:
        expected = low_pass(expected, share * lag_s)
    changed = np.abs(after["current_1_a"] - before["current_1_a"]).max()
    assert np.abs(after["current_1_a"] - expected).max() < 0.02 * changed
    for name in before.keys() - {"current_1_a"}:
        assert np.array_equal(before[name], after[name]), name


def ramp_current_a(lagged, **changes):
    """Current of a steady ramp of 0.2 rad/s in steps of 17 ms."""
    goal = 0.2 * 0.017 * np.arange(-150, 150)
    u = np.column_stack([goal, np.zeros(len(goal))])
    y = lagged.simulate(u, 0.017, lagged.model.parameter_values(changes))[100:]
    return y[:, names(lagged.model.outputs).index("current_1_a")]


def test_a_lag_removes_the_saw_tooth_and_its_jump_restores_it(bench, lagged):
    """On a steady ramp a low-pass leaves the mean of the current, above its sample at the end.

    The mean of a saw-tooth that decays by exp(-t/τ) is τ/h - r/(1 - r) jumps above its end,
    r = exp(-h/τ). τ is that of the velocity loop against all inertia, here of the rotor; the link's
    changes it little, as its joint is soft.
    """
    known = {name: q.value for name, q in bench.plant().parameters.items()}
    gain = known["velocity_gain_1_a_s_rad"]
    decay_s = known["rotor_inertia_1_kg_m2"] / (TORQUE_CONSTANT_NM_A * gain)
    remaining = np.exp(-0.017 / decay_s)
    above = decay_s / 0.017 - remaining / (1 - remaining)
    change_a = gain * known["position_gain_1_per_s"] * 0.2 * 0.017
    sampled = ramp_current_a(lagged)
    filtered = ramp_current_a(lagged, sensor_lag_1_s=0.05)
    restored = ramp_current_a(lagged, sensor_lag_1_s=0.05, sensor_lag_jump_1=-above)
    assert np.mean(filtered - sampled) == pytest.approx(above * change_a, rel=0.1)
    assert abs(np.mean(restored - sampled)) < 0.1 * above * change_a


def test_behind_a_lag_the_phase_of_the_sample_does_not_matter(lagged):
    """A low-pass of three steps leaves the mean of the current, at whatever phase it is read."""
    sampled, filtered = (
        [ramp_current_a(lagged, current_phase_1=phase, sensor_lag_1_s=lag_s).mean()
         for phase in (0.1, 0.5, 1.0)]
        for lag_s in (0.0, 0.05)
    )  # fmt: skip
    assert np.ptp(sampled) > 0.1
    assert np.ptp(filtered) < 0.01 * np.ptp(sampled)


def test_the_jump_of_a_lag_is_viscous_friction_in_the_current_alone(bench, lagged):
    """A plant that errs in its saw-tooth has made up for it by viscous friction."""
    lag_s, jump = 0.05, 0.4
    known = {name: q.value for name, q in bench.plant().parameters.items()}
    before = fine_run(lagged, sensor_lag_1_s=lag_s)
    after = fine_run(lagged, sensor_lag_1_s=lag_s, sensor_lag_jump_1=jump)
    rate = np.gradient(before["angle_1_rad"], FINE_S)
    per_rate = known["velocity_gain_1_a_s_rad"] * known["position_gain_1_per_s"] * FINE_S
    expected = low_pass(jump * per_rate * rate, lag_s)
    error = np.abs(after["current_1_a"] - before["current_1_a"] - expected)
    assert error.max() < 0.02 * np.abs(expected).max()
    assert np.array_equal(before["angle_1_rad"], after["angle_1_rad"])


@pytest.mark.parametrize(
    ("parameter", "output"),
    [("sensor_lag_angle_1_s", "angle_1_rad"), ("sensor_lag_mocap_s", "tip_x_m")],
)
def test_the_lags_of_angle_and_mocap_delay_slow_signals(lagged, parameter, output):
    before, after = (fine_run(lagged, **{parameter: lag_s}) for lag_s in (0.0, 0.02))
    expected = low_pass(before[output], 0.02)[500:]
    error = np.abs(after[output][500:] - expected).max()
    assert error < 0.05 * np.abs(before[output][500:] - expected).max()
    assert np.array_equal(after["current_1_a"], before["current_1_a"])
