"""Each effect: what it changes, by how much, and what it does not change."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

TORQUE_CONSTANT_NM_A = 6.83
STILL = np.zeros(300)
LEANING = np.full(700, 0.4)


@pytest.fixture(scope="module")
def slow(bench):
    return 0.5 * np.sin(1.44 * bench.step_s * np.arange(600))


def pair(bench, changes, **conditions):
    """Outputs without and with an effect."""
    return [bench.run(c, **conditions) for c in ({}, changes)]


def assert_same(before, after, names):
    for name in names:
        assert np.array_equal(before[name], after[name]), name


def tips(run):
    return np.column_stack([run[f"tip_{axis}_m"] for axis in "xyz"])


# Command


def test_a_short_dead_time_shifts_every_output_by_its_value(bench, slow):
    early, late = pair(bench, {"dead_time_1_s": 0.005}, goal=slow)
    for name in ("angle_1_rad", "tip_x_m"):
        slope = np.gradient(early[name][200:], bench.step_s)
        shift_s = -np.dot(late[name][200:] - early[name][200:], slope) / np.dot(slope, slope)
        assert shift_s == pytest.approx(0.005, rel=0.02), name


@pytest.mark.parametrize(("steps", "phase"), [(1, 0.3), (3, 1.0)])
def test_a_dead_time_of_whole_steps_is_that_of_goals_sent_later(bench, slow, steps, phase):
    """The saw-tooth of the current is that of a staircase, not of a smoothed one."""
    sampled = {"current_phase_1": phase}
    sent_later = np.r_[np.zeros(steps), slow[:-steps]]
    expected = bench.run(sampled, goal=sent_later)
    delay = {"dead_time_1_s": steps * bench.step_s}
    late = bench.run(sampled | delay, goal=slow)
    for name in ("angle_1_rad", "current_1_a", "tip_x_m"):
        error = (late[name] - expected[name])[200:].std()
        assert error < 0.02 * expected[name][200:].std(), name


@pytest.mark.parametrize(("dof", "change"), [(1, -0.4), (2, 0.25)])
def test_a_changed_position_gain_is_a_loop_with_that_gain(bench, dof, change):
    gain = "position_gain_1_per_s"
    shaped = {"goal_interpolation_1": 0.4, "current_phase_1": 0.3}
    other = bench.plant.parameters[gain].value * (1 + change)
    before, expected, changed = (
        bench.run(shaped | change, dof=dof)
        for change in ({}, {gain: other}, {"position_gain_change_1": change})
    )
    for name, column in expected.items():
        np.testing.assert_allclose(changed[name], column, rtol=0, atol=1e-9, err_msg=name)
    moved = [np.ptp(changed[f"angle_{j}_rad"] - before[f"angle_{j}_rad"]) for j in (1, 2)[:dof]]
    assert moved[0] > 1e-3
    assert all(second < 0.1 * moved[0] for second in moved[1:]), "a gain for each servo"


def test_current_saturation_acts_only_at_its_limit(bench):
    before = bench.run()
    peak = np.abs(before["current_1_a"]).max()
    # between two samples the current is higher than at them, but not by this much
    for margin, same in ((4.0, True), (-0.5, False)):
        cut = {"current_saturation_1_a": 10.0 - peak - margin}
        after = bench.run(cut)
        assert np.array_equal(after["angle_1_rad"], before["angle_1_rad"]) == same
        assert np.abs(after["current_1_a"]).max() <= peak + margin + 1e-12


def test_a_weaker_motor_draws_more_current_for_the_same_torque(bench):
    drift = {"torque_constant_drift_1": 0.2}
    before, after = pair(bench, drift, goal=np.full(1500, 0.3))
    assert after["current_1_a"][-1] == pytest.approx(before["current_1_a"][-1] / 0.8, rel=1e-3)
    assert after["tip_x_m"][-1] == pytest.approx(before["tip_x_m"][-1], abs=1e-5)


# Friction, as extra torque on a joint that moves as measured


def extra_torque_nm(bench, changes, goal):
    before, after = pair(bench, changes, kind="driven", goal=goal)
    if "aerodynamic_drag_nm" not in changes:
        assert_same(before, after, ["tip_x_m"])
    return TORQUE_CONSTANT_NM_A * (after["current_1_a"] - before["current_1_a"])[1:]


def test_friction_opposes_the_rate(bench):
    time_s = bench.step_s * np.arange(300)
    angle = 0.4 * np.sin(1.44 * time_s) + 0.05 * np.sin(5 * time_s)
    rate = np.gradient(np.r_[angle[0], angle], bench.step_s)[50:]

    def torque_nm(**changes):
        return extra_torque_nm(bench, changes, angle)[49:]

    coulomb = torque_nm(coulomb_friction_1_nm=4.0)
    fast = np.abs(rate) > 0.3
    assert coulomb[fast] == pytest.approx(4.0 * np.sign(rate[fast]), abs=0.01)
    viscous = torque_nm(viscous_friction_1_nm_s_rad=3.0)
    assert np.polyfit(rate, viscous, 1)[0] == pytest.approx(3.0, rel=0.03)
    stribeck = {"stribeck_friction_1_nm": 4.0}
    fades = torque_nm(**stribeck, stribeck_speed_1_rad_s=0.1)
    assert np.abs(fades[np.abs(rate) > 0.5]).max() < 0.01
    for speed_rad_s, tail in itertools.product((0.03, 0.4), (0.02, 1.0)):
        # the smooth sign rises up to 0.02 rad/s
        shape = {"stribeck_speed_1_rad_s": speed_rad_s, "stribeck_tail_1": tail}
        peak_nm = np.abs(torque_nm(**stribeck, **shape)).max()
        assert peak_nm == pytest.approx(4.0, rel=0.06)


def stribeck_torque_nm(bench, values, angle_rad, step_s):
    """Torque of a Stribeck friction of 4 N·m on a driven course, by the current that it takes."""
    plain, extra = (
        bench.run(values | {"stribeck_friction_1_nm": level}, kind="driven", goal=angle_rad,
                  payload_kg=0.0, step_s=step_s)["current_1_a"]
        for level in (0.0, 4.0)
    )  # fmt: skip
    return TORQUE_CONSTANT_NM_A * (extra - plain)[1:]


def test_stribeck_friction_builds_up_over_its_distance_after_a_reversal(bench):
    """Slower than it fades, b = 1 - 2 exp(-s/δ) at the distance s from the reversal."""
    step_s, distance_rad = 0.001, 0.01
    travelled = 0.1 * step_s * np.arange(1200)
    angle = np.where(travelled < 0.06, travelled, 0.12 - travelled)
    values = {"stribeck_speed_1_rad_s": 1.0, "stribeck_distance_1_rad": distance_rad}
    torque = stribeck_torque_nm(bench, values, angle, step_s)
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
    step_s = 0.001
    rate = 4.0 * np.arange(1, 1001) * step_s
    values = {"stribeck_speed_1_rad_s": 1.0, "stribeck_tail_1": tail}
    torque = stribeck_torque_nm(bench, values, np.cumsum(rate) * step_s, step_s)
    sliding = rate > 0.08  # beyond the smooth sign
    assert torque[sliding] == pytest.approx(4.0 * law(rate[sliding]), abs=0.1)


def test_stiction_is_lost_over_a_distance_and_regained_at_rest(bench):
    """Break away, stop briefly, go on, rest, go on, turn round; memory by scipy's integrator."""
    force_nm, distance, dwell_s, rate = 4.0, 0.02, 2.0, 0.15
    legs = [(1.0, 0), (1.5, 1), (0.05, 0), (1.0, 1), (3.0, 0), (1.5, 1), (1.5, -1)]
    rates = np.concatenate([np.full(round(s / bench.step_s), d * rate) for s, d in legs])
    angle = np.cumsum(rates) * bench.step_s
    changes = {"stiction_1_nm": force_nm, "stiction_distance_1_rad": distance,
               "stiction_dwell_1_s": dwell_s}  # fmt: skip
    torque = extra_torque_nm(bench, changes, angle)

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
    assert np.abs(torque[start[5] - 20 : start[5] - 2]).max() < 0.2 * force_nm, "before a stop"


def test_cogging_takes_no_energy_over_its_period(bench):
    """A slow turn over whole periods of 24 a turn; the filter of the angle lags by 17 ms."""
    period, rate = 2 * np.pi / 24, 0.1
    angle = np.arange(0, 2.5 * period, rate * bench.step_s)
    changes = {"cogging_1_nm": 1.5, "cogging_cosine_1_nm": -0.7}
    torque = extra_torque_nm(bench, changes, angle)
    expected = 1.5 * np.sin(24 * angle) - 0.7 * np.cos(24 * angle)
    count = round(period / (rate * bench.step_s))
    settled = slice(len(torque) - count, None)
    assert torque[settled] == pytest.approx(expected[settled], abs=0.08)
    assert abs(torque[settled].sum()) < 0.02 * np.abs(torque[settled]).sum()


def test_drag_takes_energy_and_grows_with_the_square(bench):
    losses = []
    for amplitude in (0.2, 0.4):
        goal = amplitude * np.sin(2 * bench.step_s * np.arange(300))
        extra_nm = extra_torque_nm(bench, {"aerodynamic_drag_nm": 1.0}, goal)
        losses.append(np.mean(extra_nm * np.gradient(goal, bench.step_s)))
    assert losses[0] > 0
    assert 6 < losses[1] / losses[0] < 12  # linear drag would have 4, a cubic one 16


@pytest.mark.parametrize("offset_nm", [-20.0, 20.0])
def test_a_pull_on_the_joint_adds_to_the_load_of_the_gear(bench, offset_nm):
    """With it the gear carries |G + T|: friction μ |G + T| where the link alone has μ |G|."""
    share, rise = 0.2, 0.2 * bench.step_s * np.arange(300)
    change = {}
    for pull in (0.0, offset_nm):
        smooth, rough = (
            bench.run({"load_offset_1_nm": pull, "load_dependent_friction_1": s},
                      goal=rise)["current_1_a"][-1]
            for s in (0.0, share)
        )  # fmt: skip
        change[pull] = TORQUE_CONSTANT_NM_A * (rough - smooth)
    load_nm = change[0.0] / share  # rising: friction is positive, and the link falls forwards
    assert load_nm > 3.0
    assert change[offset_nm] == pytest.approx(share * abs(load_nm + offset_nm), rel=0.1)


# Gear


def test_backlash_moves_the_load_from_side_to_side_and_the_encoder_does_not_show_it(bench):
    sides = []
    for side in (1, -1):
        before, after = pair(bench, {"backlash_1_rad": 0.02}, goal=side * LEANING)
        assert abs(after["angle_1_rad"][-1] - before["angle_1_rad"][-1]) < 1e-4
        moved = (tips(after) - tips(before))[-1]
        # half the play times the reach, and the sag that follows
        assert np.linalg.norm(moved) > 0.01 * 1.0
        sides.append(moved[0])
    assert sides[0] == pytest.approx(-sides[1], rel=1e-6) and sides[0] > 0.005


@pytest.mark.parametrize("fraction", [0.0, 0.5, 1.0])
def test_play_in_the_mount_moves_the_markers_alone(bench, fraction):
    play = {"backlash_1_rad": 0.01, "backlash_mount_fraction": fraction}
    before, after = pair(bench, play, goal=LEANING)
    moved, reach = (tips(after) - tips(before))[-1], np.linalg.norm(tips(before)[-1])
    # the play of the gear also bends the link
    rel = 1e-3 if fraction == 1.0 else 0.15
    assert np.linalg.norm(moved) == pytest.approx(0.005 * reach, rel=rel)
    assert moved[0] > 0
    if fraction == 1.0:
        assert_same(*pair(bench, play), ["angle_1_rad", "current_1_a"])


def test_joint_elasticity_adds_its_compliance_to_the_roots(bench):
    """A link at rest: the tip sinks as with a root of 1 / (1/K + c), the encoder stays."""
    compliance, limit = 2e-3, {"root_limit_moment_nm": 80.0}
    cases = (
        {"root_stiffness_1_nm_rad": 350.0},
        {"root_stiffness_1_nm_rad": 1 / (1 / 350 + compliance)},
        {"root_stiffness_1_nm_rad": 350.0, "joint_elasticity_1_rad_nm": compliance},
    )
    goal = np.full(1500, 0.2)
    plain, softer, geared = (bench.run(limit | case, goal=goal, payload_kg=0.0) for case in cases)
    sunk = geared["tip_x_m"][-1] - plain["tip_x_m"][-1]
    assert sunk > 0.002
    assert sunk == pytest.approx(softer["tip_x_m"][-1] - plain["tip_x_m"][-1], rel=0.1)


# Mass and joint torque


def test_unmodelled_payload_is_payload(bench):
    declared = bench.run(payload_kg=1.5)
    hidden = bench.run({"unmodelled_payload_kg": 0.5}, payload_kg=1.0)
    for name, values in declared.items():
        assert hidden[name] == pytest.approx(values, abs=1e-12)


def test_payload_offset_leans_upright_and_needs_a_payload(bench):
    loaded, empty = (
        bench.run({"payload_offset_share": 0.05}, goal=STILL, payload_kg=kg) for kg in (1.0, 0.0)
    )
    assert loaded["tip_x_m"][-1] > 0.002
    assert np.abs(empty["tip_x_m"]).max() < 1e-12


@pytest.mark.parametrize("sign", [-1, 1])
def test_load_offset_shows_in_the_current(bench, sign):
    before, after = pair(bench, {"load_offset_1_nm": sign * TORQUE_CONSTANT_NM_A})
    change = after["current_1_a"] - before["current_1_a"]
    assert change == pytest.approx(-sign, abs=1e-6)  # pushes up: 1 A less
    assert after["angle_1_rad"] == pytest.approx(before["angle_1_rad"], abs=1e-8)


# Bend


def test_prebend_leans_the_unloaded_link(bench):
    bent, other = (
        bench.run({"prebend_1_rad": bend}, goal=STILL, payload_kg=0.0)["tip_x_m"][-1]
        for bend in (0.03, -0.03)
    )
    evenly_m = 0.03 * 0.95 / 2  # the weight of the link bends it a little further
    assert evenly_m < bent < 1.2 * evenly_m
    assert bent == pytest.approx(-other, rel=1e-9)


def sag_m(bench, changes, goal=LEANING, at=-1):
    """How far the tip hangs below a rigid link's, across it."""
    run = bench.run(changes, goal=goal)
    angle = run["angle_1_rad"][at]
    return run["tip_x_m"][at] * np.cos(angle) - run["tip_z_m"][at] * np.sin(angle)


def test_stiffness_depends_on_side_size_and_time(bench):
    plain = {s: sag_m(bench, {}, s * LEANING) for s in (-1, 1)}
    assert plain[1] == pytest.approx(-plain[-1], rel=1e-9)
    side = {"directional_stiffness_1": 0.2}
    assert sag_m(bench, side, LEANING) < 0.95 * plain[1]
    assert sag_m(bench, side, -LEANING) < 1.05 * plain[-1] < 0
    assert sag_m(bench, {"softening_share": 0.3}) > 1.05 * plain[1]
    assert sag_m(bench, {"hardening_share": 3.0}) < 0.95 * plain[1]
    early, late = (sag_m(bench, {"leak_share": 0.2}, at=k) for k in (240, 690))
    assert plain[1] < early < late
    steady = [sag_m(bench, {}, at=k) for k in (480, 690)]
    assert abs(steady[1] - steady[0]) < 0.02 * (late - early)


def test_creep_relaxes_and_hysteresis_remembers(bench):
    # Far from its limit moment, at which the jump of the goal would fold the link.
    creep = {"creep_share_1": 0.3, "creep_time_s": 2.0, "root_limit_moment_nm": 80.0}
    up = np.r_[np.zeros(40), np.full(660, 0.4)]
    soon, late = (sag_m(bench, creep, up, at=k) for k in (240, 690))
    assert late > soon + 1e-3
    slow = 0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, 900))  # so that nothing is shaken loose
    there_and_back = {s: 0.3 + s * 0.3 * np.r_[slow, np.zeros(600)] for s in (-1, 1)}
    share = {"hysteresis_share_1": 0.5}
    rest = {s: sag_m(bench, share, g) for s, g in there_and_back.items()}
    plain = {s: sag_m(bench, {}, g) for s, g in there_and_back.items()}
    assert abs(plain[1] - plain[-1]) < 1e-5 < 5e-4 < rest[1] - rest[-1]


@pytest.mark.parametrize("dof", [1, 2])
def test_coupling_bends_across(bench, dof):
    """A link of one joint bends across its plane by the share of its sag, more by its weight."""
    goal = np.full(600, 0.3)
    x, y = {}, {}
    for share in (-0.2, 0.0, 0.2):
        changes = {"coupling_share": share}
        run = bench.run(changes, dof=dof, goal=goal)
        x[share], y[share] = run["tip_x_m"][-1], run["tip_y_m"][-1]
    if dof == 2:
        assert x[0.2] != pytest.approx(x[-0.2], abs=1e-3)
        return
    stiff = bench.run({"root_stiffness_1_nm_rad": 1000.0, "span_stiffness_1_nm_rad": 1200.0},
                      goal=goal)  # fmt: skip
    sag = x[0.0] - stiff["tip_x_m"][-1]
    assert y[0.0] == pytest.approx(0.0, abs=1e-9)
    assert y[0.2] == pytest.approx(-y[-0.2], rel=1e-6)
    assert 0.2 * sag < abs(y[0.2]) < 0.5 * sag
    assert x[0.2] == pytest.approx(x[-0.2], abs=1e-9)


def test_a_link_with_a_soft_side_starts_at_rest(bench):
    """Its stiffness at a bend is not that of the straight link."""
    changes = {"directional_stiffness_1": 0.3, "payload_offset_share": 0.05}
    run = bench.run(changes, goal=STILL, payload_kg=2.0)
    assert abs(run["tip_x_m"][0]) > 0.002
    assert np.ptp(run["tip_x_m"]) < 1e-5


# Encoder and current


def test_encoder_offset_turns_the_link_and_hides_itself(bench):
    offset = {"encoder_offset_1_rad": 0.05}
    run = bench.run(offset, goal=np.full(600, 0.05))
    assert run["angle_1_rad"][-1] == pytest.approx(0.05, abs=1e-6)
    assert run["tip_x_m"][-1] == pytest.approx(0.0, abs=1e-6)  # the servo stands upright


@pytest.mark.parametrize("effects", [["encoder_offset"], ["encoder_offset", "prebend"]])
def test_the_index_is_that_of_noise_where_the_encoder_shows_upright(bench, effects):
    """Its reference is the link at rest, bent by the payload that the offset lets lean."""
    changes = dict.fromkeys((f"{e}_1_rad" for e in effects), 0.05)
    straight, leaning = pair(bench, changes, goal=STILL, payload_kg=2.0)
    assert abs(leaning["tip_x_m"][-1]) > 0.02
    assert leaning["di"] == pytest.approx(straight["di"], abs=1e-5)


def test_the_servo_puts_a_rippled_reading_on_its_goal(bench):
    """The joint then stands where the reading is the goal: a root of q + a sin nq + b cos nq."""
    goal, sine, cosine, order = 0.31, 0.006, -0.004, 16.0

    def excess(q):
        return q + sine * np.sin(order * q) + cosine * np.cos(order * q) - goal

    true = brentq(excess, goal - 0.02, goal + 0.02)
    changes = {"encoder_ripple_1_rad": sine, "encoder_ripple_cosine_1_rad": cosine}
    rippled = bench.run(changes, goal=np.full(200, goal))
    plain = bench.run(goal=np.full(200, true))
    assert abs(true - goal) > 1e-3
    assert rippled["angle_1_rad"] == pytest.approx(goal, abs=2e-6)
    assert rippled["tip_x_m"][-1] == pytest.approx(plain["tip_x_m"][-1], abs=2e-6)
    assert np.ptp(rippled["tip_x_m"]) < 1e-5, "it starts at rest"


def test_current_errors_change_the_current_alone(bench):
    before, after = pair(bench, {"current_bias_1_a": 0.3, "current_scale_1": 0.1})
    assert after["current_1_a"] == pytest.approx(1.1 * before["current_1_a"] + 0.3, abs=1e-12)
    assert_same(before, after, before.keys() - {"current_1_a"})


# Motion capture


@pytest.mark.parametrize(
    "changes",
    [
        {"marker_frame_tilt_rad": 0.1, "marker_frame_roll_rad": 0.05,
         "marker_frame_yaw_rad": -0.2},
        {"marker_scale": 0.02},
    ],
)  # fmt: skip
def test_a_turned_or_scaled_frame_moves_the_tip_alone(bench, changes):
    before, after = pair(bench, changes)
    yaw, roll, tilt = (changes.get(f"marker_frame_{n}_rad", 0.0) for n in ("yaw", "roll", "tilt"))
    expected = Rotation.from_euler("zxy", [yaw, roll, tilt]).apply(tips(before))
    expected *= 1 + changes.get("marker_scale", 0.0)
    assert tips(after) == pytest.approx(expected, abs=1e-12)
    assert_same(before, after, ["angle_1_rad", "current_1_a", "di"])


@pytest.mark.parametrize("delay_s", [0.034, -0.034])
def test_sync_offset_delays_the_mocap_alone(bench, delay_s):
    """Two ticks: the mocap shows what was, or will be, two rows away."""
    before, after = pair(bench, {"sync_offset_s": delay_s})
    assert_same(before, after, ["angle_1_rad", "current_1_a"])
    true, shown = before["tip_x_m"], after["tip_x_m"]
    error = (shown - np.roll(true, round(delay_s / bench.step_s)))[100:-100]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean((shown - true)[100:-100] ** 2))
    assert not np.array_equal(before["di"], after["di"])


# Lag of a sensor

FINE_S = 1e-3


def fine_run(bench, step_rad=0.0, **changes):
    """Outputs by name each millisecond; with a step the goal is a coarse staircase."""
    goal = 0.1 * np.sin(3 * FINE_S * np.arange(2500))
    goal = step_rad * np.round(goal / step_rad) if step_rad else goal
    return bench.run(changes, goal=goal, step_s=FINE_S)


def low_pass(signal, time_s):
    """First-order low-pass of samples, by the bilinear rule, at rest before them."""
    pole = (2 * time_s / FINE_S - 1) / (2 * time_s / FINE_S + 1)
    gain = (1 - pole) / 2
    return lfilter([gain, gain], [1, -pole], signal - signal[0]) + signal[0]


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_sensor_lag_is_a_low_pass_of_the_current_alone(bench, share):
    """Of first order, or of two equal stages where the document states a fraction of the second.

    A step of the goal makes the current jump by 4 A between two samples; the rule misses half a
    sample of it, 0.03 A.
    """
    lag_s = 0.08
    before, after = (
        fine_run(bench, 0.02, sensor_lag_second_1=share, sensor_lag_1_s=s) for s in (0.0, lag_s)
    )
    expected = low_pass(before["current_1_a"], (1 - share) * lag_s)
    if share:
        expected = low_pass(expected, share * lag_s)
    changed = np.abs(after["current_1_a"] - before["current_1_a"]).max()
    assert np.abs(after["current_1_a"] - expected).max() < 0.02 * changed
    assert_same(before, after, before.keys() - {"current_1_a"})


def ramp_current_a(bench, **changes):
    """Current of a steady ramp of 0.2 rad/s in steps of 17 ms."""
    goal = 0.2 * 0.017 * np.arange(-150, 150)
    return bench.run(changes, goal=goal, payload_kg=0.0)["current_1_a"][100:]


def test_a_lag_removes_the_saw_tooth_and_its_jump_restores_it(bench):
    """On a steady ramp a low-pass shows the mean of the current, above its sample at the end.

    The mean of a saw-tooth that decays by exp(-t/τ) is τ/h - r/(1 - r) jumps above its end,
    r = exp(-h/τ). τ is that of the velocity loop against all inertia, here of the rotor; the link's
    changes it little, as its joint is soft.
    """
    known = {name: q.value for name, q in bench.plant.parameters.items()}
    gain = known["velocity_gain_1_a_s_rad"]
    decay_s = known["rotor_inertia_1_kg_m2"] / (TORQUE_CONSTANT_NM_A * gain)
    remaining = np.exp(-0.017 / decay_s)
    above = decay_s / 0.017 - remaining / (1 - remaining)
    change_a = gain * known["position_gain_1_per_s"] * 0.2 * 0.017
    sampled = ramp_current_a(bench)
    filtered = ramp_current_a(bench, sensor_lag_1_s=0.05)
    restored = ramp_current_a(bench, sensor_lag_1_s=0.05, sensor_lag_jump_1=-above)
    assert np.mean(filtered - sampled) == pytest.approx(above * change_a, rel=0.1)
    assert abs(np.mean(restored - sampled)) < 0.1 * above * change_a


@pytest.mark.parametrize(
    ("parameter", "output"),
    [("sensor_lag_angle_1_s", "angle_1_rad"), ("sensor_lag_mocap_s", "tip_x_m")],
)
def test_the_lags_of_angle_and_mocap_delay_slow_signals(bench, parameter, output):
    before, after = (fine_run(bench, **{parameter: lag_s}) for lag_s in (0.0, 0.02))
    expected = low_pass(before[output], 0.02)[500:]
    error = np.abs(after[output][500:] - expected).max()
    assert error < 0.05 * np.abs(before[output][500:] - expected).max()
    assert_same(before, after, ["current_1_a"])
