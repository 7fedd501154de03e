"""Effects of command, servo, gear and load: what they change, by how much, and what they do not."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

TORQUE_CONSTANT_NM_A = 6.83
STILL = np.zeros(300)
LEANING = np.full(700, 0.4)


@pytest.fixture(scope="module")
def slow(bench):
    return 0.5 * np.sin(1.44 * bench.step_s * np.arange(600))


# --- command --------------------------------------------------------------------------------------


@pytest.mark.parametrize("dead_s", [0.005, 0.06])
def test_dead_time_shifts_every_output_by_its_value(bench, slow, dead_s):
    early, late = (
        bench.run(["dead_time"], {"dead_time_1_s": s}, goal=slow, count=600) for s in (0.0, dead_s)
    )
    for name in ("angle_1_rad", "tip_x_m"):
        slope = np.gradient(early[name][200:], bench.step_s)
        shift_s = -np.dot(late[name][200:] - early[name][200:], slope) / np.dot(slope, slope)
        assert shift_s == pytest.approx(dead_s, rel=0.02), name


@pytest.mark.parametrize(("steps", "phase"), [(1, 0.3), (3, 1.0)])
def test_a_dead_time_of_whole_steps_is_that_of_goals_sent_later(bench, slow, steps, phase):
    """The saw-tooth of the current is that of a staircase, not of a smoothed one."""
    sampled = {"current_phase_1": phase}
    sent_later = np.r_[np.zeros(steps), slow[:-steps]]
    expected = bench.run(["dead_time"], sampled, goal=sent_later, count=600)
    delay = {"dead_time_1_s": steps * bench.step_s}
    late = bench.run(["dead_time"], sampled | delay, goal=slow, count=600)
    for name in ("angle_1_rad", "current_1_a", "tip_x_m"):
        error = (late[name] - expected[name])[200:].std()
        assert error < 0.02 * expected[name][200:].std(), name


def test_the_phase_of_a_dead_time_changes_the_sampled_current_alone(bench, slow):
    none, none_shifted, late, shifted = (
        bench.run(["dead_time"], {"dead_time_1_s": dead_s, "dead_time_phase_1": shift},
                  goal=slow, count=600)
        for dead_s in (0.0, 0.02) for shift in (0.0, -0.5)
    )  # fmt: skip
    assert np.array_equal(none["current_1_a"], none_shifted["current_1_a"]), "no delay, no phase"
    assert np.array_equal(late["angle_1_rad"], shifted["angle_1_rad"])
    rate = np.gradient(late["angle_1_rad"], bench.step_s)[200:]
    above = (shifted["current_1_a"] - late["current_1_a"])[200:]
    assert np.corrcoef(above, rate)[0, 1] > 0.95, "sooner after a jump the current is larger"


@pytest.mark.parametrize(("dof", "change"), [(1, -0.4), (2, 0.25)])
def test_a_changed_position_gain_is_a_loop_with_that_gain(bench, dof, change):
    effects, gain = ["position_gain_change"], "position_gain_1_per_s"
    shaped = {"goal_interpolation_1": 0.4, "current_phase_1": 0.3}
    other = bench.plant().parameters[gain].value * (1 + change)
    before, expected, changed = (
        bench.run(effects, shaped | change, dof=dof)
        for change in ({}, {gain: other}, {"position_gain_change_1": change})
    )
    for name, column in expected.items():
        np.testing.assert_allclose(changed[name], column, rtol=0, atol=1e-9, err_msg=name)
    moved = [np.ptp(changed[f"angle_{j}_rad"] - before[f"angle_{j}_rad"]) for j in (1, 2)[:dof]]
    assert moved[0] > 1e-3
    assert all(second < 0.1 * moved[0] for second in moved[1:]), "a gain for each servo"


def test_current_saturation_acts_only_at_its_limit(bench):
    before = bench.run(["current_saturation"])
    peak = np.abs(before["current_1_a"]).max()
    # between two samples the current is higher than at them, but not by this much
    for margin, same in ((4.0, True), (-0.5, False)):
        cut = {"current_saturation_1_a": 10.0 - peak - margin}
        after = bench.run(["current_saturation"], cut)
        assert np.array_equal(after["angle_1_rad"], before["angle_1_rad"]) == same
        assert np.abs(after["current_1_a"]).max() <= peak + margin + 1e-12


def test_torque_constant_drift_scales_the_current(bench):
    """At rest the link needs the same torque, which costs more amperes."""
    before, after = (
        bench.run(["torque_constant_drift"], {"torque_constant_drift_1": drift},
                  goal=np.full(1500, 0.3), count=1500)
        for drift in (0.0, 0.2)
    )  # fmt: skip
    assert after["current_1_a"][-1] == pytest.approx(before["current_1_a"][-1] / 0.8, rel=1e-3)
    assert after["tip_x_m"][-1] == pytest.approx(before["tip_x_m"][-1], abs=1e-5)


# --- friction -------------------------------------------------------------------------------------


def extra_torque_nm(bench, effect, changes, goal, **conditions):
    """Extra torque by an effect on a joint that moves as measured; the tip does not change."""
    before, after = (
        bench.run([effect], c, kind="driven", goal=goal, count=len(goal), **conditions)
        for c in ({}, changes)
    )
    if effect not in ("aerodynamic_drag",):
        assert np.array_equal(after["tip_x_m"], before["tip_x_m"])
    return TORQUE_CONSTANT_NM_A * (after["current_1_a"] - before["current_1_a"])[1:]


def test_friction_opposes_the_rate(bench):
    time_s = bench.step_s * np.arange(300)
    angle = 0.4 * np.sin(1.44 * time_s) + 0.05 * np.sin(5 * time_s)
    rate = np.gradient(np.r_[angle[0], angle], bench.step_s)[50:]
    coulomb, viscous, stribeck = (
        extra_torque_nm(bench, effect, changes, angle)[49:]
        for effect, changes in (
            ("coulomb_friction", {"coulomb_friction_1_nm": 4.0}),
            ("viscous_friction", {"viscous_friction_1_nm_s_rad": 3.0}),
            ("stribeck_friction", {"stribeck_friction_1_nm": 4.0, "stribeck_speed_1_rad_s": 0.1}),
        )
    )
    fast = np.abs(rate) > 0.3
    assert coulomb[fast] == pytest.approx(4.0 * np.sign(rate[fast]), abs=0.01)
    assert np.polyfit(rate, viscous, 1)[0] == pytest.approx(3.0, rel=0.03)
    assert np.abs(stribeck[np.abs(rate) > 0.5]).max() < 0.01
    for speed_rad_s, tail in itertools.product((0.03, 0.4), (0.02, 1.0)):
        # the smooth sign rises up to 0.02 rad/s
        changes = {"stribeck_friction_1_nm": 4.0, "stribeck_speed_1_rad_s": speed_rad_s,
                   "stribeck_tail_1": tail}  # fmt: skip
        peak_nm = np.abs(extra_torque_nm(bench, "stribeck_friction", changes, angle)[49:]).max()
        assert peak_nm == pytest.approx(4.0, rel=0.06)


def stribeck_torque_nm(bench, values, angle_rad, step_s):
    """Torque of a Stribeck friction of 4 N·m on a driven course, by the current that it takes."""
    plant = bench.plant("stribeck_friction").with_values(values)
    model = CompiledModel(plant.step_model(1, "driven"))
    u = np.column_stack([angle_rad, np.zeros(len(angle_rad))])
    column = names(model.model.outputs).index("current_1_a")
    plain, extra = (
        model.simulate(u, step_s, model.model.parameter_values({"stribeck_friction_1_nm": level}))
        for level in (0.0, 4.0)
    )
    return TORQUE_CONSTANT_NM_A * (extra - plain)[1:, column]


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
    torque = extra_torque_nm(bench, "stiction", changes, angle)

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
    torque = extra_torque_nm(bench, "cogging", changes, angle)
    expected = 1.5 * np.sin(24 * angle) - 0.7 * np.cos(24 * angle)
    count = round(period / (rate * bench.step_s))
    settled = slice(len(torque) - count, None)
    assert torque[settled] == pytest.approx(expected[settled], abs=0.08)
    assert abs(torque[settled].sum()) < 0.02 * np.abs(torque[settled]).sum()


@pytest.mark.parametrize("offset_nm", [-20.0, 20.0])
def test_a_pull_on_the_joint_adds_to_the_load_of_the_gear(bench, offset_nm):
    """With it the gear carries |G + T|: friction μ |G + T| where the link alone has μ |G|."""
    effects, share = ["load_dependent_friction", "load_offset"], 0.2
    rise = 0.2 * bench.step_s * np.arange(300)
    change = {}
    for pull in (0.0, offset_nm):
        smooth, rough = (
            bench.run(effects, {"load_offset_1_nm": pull, "load_dependent_friction_1": s},
                      goal=rise)["current_1_a"][-1]
            for s in (0.0, share)
        )  # fmt: skip
        change[pull] = TORQUE_CONSTANT_NM_A * (rough - smooth)
    load_nm = change[0.0] / share  # rising: friction is positive, and the link falls forwards
    assert load_nm > 3.0
    assert change[offset_nm] == pytest.approx(share * abs(load_nm + offset_nm), rel=0.1)


# --- gear -----------------------------------------------------------------------------------------


def tips(bench, effect, changes, goal):
    """Outputs at rest without and with an effect."""
    runs = (bench.run([effect], c, goal=goal, count=len(goal)) for c in ({}, changes))
    return [{name: y[-1] for name, y in run.items()} for run in runs]


def test_backlash_moves_the_load_from_side_to_side_and_the_encoder_does_not_show_it(bench):
    sides = []
    for side in (1, -1):
        before, after = tips(bench, "backlash", {"backlash_1_rad": 0.02}, side * LEANING)
        assert abs(after["angle_1_rad"] - before["angle_1_rad"]) < 1e-4
        moved = np.hypot(*(after[f"tip_{a}_m"] - before[f"tip_{a}_m"] for a in "xz"))
        assert moved > 0.01 * 1.0  # half the play times the reach, and the sag that follows
        sides.append(after["tip_x_m"] - before["tip_x_m"])
    assert sides[0] == pytest.approx(-sides[1], rel=1e-6) and sides[0] > 0.005


def test_play_in_the_mount_moves_the_markers_alone(bench):
    for fraction in (0.0, 0.5, 1.0):
        play = {"backlash_1_rad": 0.01, "backlash_mount_fraction": fraction}
        before, after = tips(bench, "backlash", play, LEANING)
        moved = np.hypot(*(after[n] - before[n] for n in ("tip_x_m", "tip_z_m")))
        reach = np.hypot(before["tip_x_m"], before["tip_z_m"])
        # the play of the gear also bends the link
        assert moved == pytest.approx(0.005 * reach, rel=1e-3 if fraction == 1.0 else 0.15)
    assert after["tip_x_m"] > before["tip_x_m"]
    still, moving = (bench.run(["backlash"], c) for c in ({}, play))
    for name in ("angle_1_rad", "current_1_a"):
        assert np.array_equal(still[name], moving[name])


def test_joint_elasticity_adds_its_compliance_to_the_roots(bench):
    """A link at rest: the tip sinks as with a root of 1 / (1/K + c), the encoder stays."""
    compliance, limit = 2e-3, {"root_limit_moment_nm": 80.0}
    cases = (
        {"root_stiffness_1_nm_rad": 350.0},
        {"root_stiffness_1_nm_rad": 1 / (1 / 350 + compliance)},
        {"root_stiffness_1_nm_rad": 350.0, "joint_elasticity_1_rad_nm": compliance},
    )
    goal = np.full(1500, 0.2)
    plain, softer, geared = (
        bench.run(["joint_elasticity"], limit | case, goal=goal, count=1500, payload_kg=0.0)
        for case in cases
    )
    sunk = geared["tip_x_m"][-1] - plain["tip_x_m"][-1]
    assert sunk > 0.002
    assert sunk == pytest.approx(softer["tip_x_m"][-1] - plain["tip_x_m"][-1], rel=0.1)


# --- mass and joint torque ------------------------------------------------------------------------


def test_unmodelled_payload_is_payload(bench):
    declared = bench.run(["unmodelled_payload"], payload_kg=1.5)
    hidden = bench.run(["unmodelled_payload"], {"unmodelled_payload_kg": 0.5}, payload_kg=1.0)
    for name, values in declared.items():
        assert hidden[name] == pytest.approx(values, abs=1e-12)


def test_payload_offset_leans_upright_and_needs_a_payload(bench):
    loaded, empty = (
        bench.run(["payload_offset"], {"payload_offset_share": 0.05}, goal=STILL, payload_kg=kg)
        for kg in (1.0, 0.0)
    )
    assert loaded["tip_x_m"][-1] > 0.002
    assert np.abs(empty["tip_x_m"]).max() < 1e-12


def test_load_offset_shows_in_the_current(bench):
    runs = {s: bench.run(["load_offset"], {"load_offset_1_nm": s * 6.83}) for s in (-1, 0, 1)}
    for sign in (-1, 1):
        change = runs[sign]["current_1_a"] - runs[0]["current_1_a"]
        assert change == pytest.approx(-sign, abs=1e-6)  # pushes up: 1 A less
        assert runs[sign]["angle_1_rad"] == pytest.approx(runs[0]["angle_1_rad"], abs=1e-8)


def test_drag_takes_energy_and_grows_with_the_square(bench):
    losses = []
    for amplitude in (0.2, 0.4):
        goal = amplitude * np.sin(2 * bench.step_s * np.arange(300))
        extra_nm = extra_torque_nm(bench, "aerodynamic_drag", {"aerodynamic_drag_nm": 1.0}, goal)
        losses.append(np.mean(extra_nm * np.gradient(goal, bench.step_s)))
    assert losses[0] > 0
    assert 6 < losses[1] / losses[0] < 12  # linear drag would give 4, a cubic one 16
