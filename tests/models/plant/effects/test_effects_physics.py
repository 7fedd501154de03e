"""Each effect changes what it should, and leaves alone what it should not touch."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

STILL = np.zeros(300)
HELD = np.full(700, 0.4)


def unchanged(bench, effects, changes, outputs, **conditions):
    before, after = bench.run(effects, **conditions), bench.run(effects, changes, **conditions)
    return all(np.array_equal(before[name], after[name]) for name in outputs)


# --- friction -------------------------------------------------------------------------------------


def friction_nm(bench, effect, changes):
    """Extra torque of a driven run, and its rate; the link itself does not notice."""
    before, after = (bench.run([effect], c, kind="driven") for c in ({}, changes))
    assert np.array_equal(after["tip_x_m"], before["tip_x_m"])
    angle = bench.inputs(bench.compiled((effect,), 1, "driven").model, 300)[:, 0]
    rate = np.gradient(np.r_[angle[0], angle], bench.step_s)
    return 6.83 * (after["current_1_a"] - before["current_1_a"])[50:], rate[50:]


def test_friction_opposes_the_rate_each_in_its_way(bench):
    torque, rate = friction_nm(bench, "coulomb_friction", {"coulomb_friction_1_nm": 4.0})
    fast = np.abs(rate) > 0.3
    assert torque[fast] == pytest.approx(4.0 * np.sign(rate[fast]), abs=0.01)
    torque, rate = friction_nm(bench, "viscous_friction", {"viscous_friction_1_nm_s_rad": 3.0})
    assert np.polyfit(rate, torque, 1)[0] == pytest.approx(3.0, rel=0.03)
    strength = {
        "stribeck_friction_1_nm": 4.0,
        "stribeck_speed_1_rad_s": 0.1,
        "stribeck_distance_1_rad": 2e-5,
    }
    torque, rate = friction_nm(bench, "stribeck_friction", strength)
    assert np.abs(torque[np.abs(rate) > 0.5]).max() < 0.01
    for speed_rad_s, tail in itertools.product((0.03, 0.1, 0.4), (0.02, 0.5, 1.0)):
        # the smooth sign rises up to 0.02 rad/s
        strength |= {"stribeck_speed_1_rad_s": speed_rad_s, "stribeck_tail_1": tail}
        torque, _ = friction_nm(bench, "stribeck_friction", strength)
        assert np.abs(torque).max() == pytest.approx(4.0, rel=0.06)


def test_load_dependent_friction_grows_with_the_payload(bench):
    share = {"load_dependent_friction_1": 0.2}
    loss = []
    for payload_kg in (0.0, 2.0):
        runs = [
            bench.run(["load_dependent_friction"], c, kind="driven", payload_kg=payload_kg)
            for c in ({}, share)
        ]
        loss.append(np.abs(runs[1]["current_1_a"] - runs[0]["current_1_a"]).mean())
    assert loss[1] > 2 * loss[0] > 0


# --- gear -----------------------------------------------------------------------------------------


def test_backlash_is_invisible_to_the_encoder(bench):
    play = {"backlash_1_rad": 0.02}
    before, after = (bench.run(["backlash"], c, goal=HELD, count=700) for c in ({}, play))
    assert abs(after["angle_1_rad"][-1] - before["angle_1_rad"][-1]) < 1e-4
    moved = np.hypot(*(after[f"tip_{a}_m"][-1] - before[f"tip_{a}_m"][-1] for a in "xz"))
    assert moved > 0.01 * 1.0  # half the play times the reach of 1 m, and the sag that follows


def test_backlash_moves_the_load_from_side_to_side(bench):
    play = {"backlash_1_rad": 0.02}
    sides = []
    for goal in (HELD, -HELD):
        before, after = (bench.run(["backlash"], c, goal=goal, count=700) for c in ({}, play))
        sides.append(after["tip_x_m"][-1] - before["tip_x_m"][-1])
    assert sides[0] == pytest.approx(-sides[1], rel=1e-6) and sides[0] > 0.005


def test_play_in_the_mount_moves_the_markers_alone(bench):
    play = {"backlash_1_rad": 0.01, "backlash_mount_fraction": 1.0}
    assert unchanged(bench, ["backlash"], play, ("angle_1_rad", "current_1_a"))
    for side in (1.0, -1.0):
        goal = side * HELD
        before, after = (bench.run(["backlash"], c, goal=goal, count=700) for c in ({}, play))
        moved = np.hypot(*(after[n][-1] - before[n][-1] for n in ("tip_x_m", "tip_z_m")))
        reach = np.hypot(before["tip_x_m"][-1], before["tip_z_m"][-1])
        assert moved == pytest.approx(0.005 * reach, rel=1e-3)
        assert side * (after["tip_x_m"][-1] - before["tip_x_m"][-1]) > 0


def test_play_in_gear_and_mount_adds_up_at_rest(bench):
    tips = []
    for fraction in (0.0, 0.5, 1.0):
        play = {"backlash_1_rad": 0.01, "backlash_mount_fraction": fraction}
        tips.append(bench.run(["backlash"], play, goal=HELD, count=700)["tip_x_m"][-1])
    assert np.ptp(tips) < 0.1 * 0.005  # the play of the gear also bends the link


def test_joint_elasticity_adds_its_compliance_to_the_roots(bench):
    """A link at rest: the tip sinks as with a root of 1 / (1/K + c), the encoder stays."""
    compliance = 2e-3
    soft = {"root_stiffness_1_nm_rad": 1 / (1 / 350 + compliance), "root_limit_moment_nm": 80.0}
    stiff = {"root_stiffness_1_nm_rad": 350.0, "root_limit_moment_nm": 80.0}
    gear = stiff | {"joint_elasticity_1_rad_nm": compliance}
    conditions = {"goal": np.full(1500, 0.2), "count": 1500, "payload_kg": 0.0}
    plain, softer, geared = (
        bench.run(["joint_elasticity"], c, **conditions)["tip_x_m"][-1] for c in (stiff, soft, gear)
    )
    assert geared - plain > 0.002
    assert geared - plain == pytest.approx(softer - plain, rel=0.1)


# --- mass and joint torque ------------------------------------------------------------------------


def test_unmodelled_payload_is_payload(bench):
    declared = bench.run(["unmodelled_payload"], payload_kg=1.5)
    hidden = bench.run(["unmodelled_payload"], {"unmodelled_payload_kg": 0.5}, payload_kg=1.0)
    for name, values in declared.items():
        assert hidden[name] == pytest.approx(values, abs=1e-12)


def test_payload_offset_leans_upright_and_needs_a_payload(bench):
    shifted = {"payload_offset_share": 0.05}
    conditions = {"goal": STILL, "count": 300}
    after = bench.run(["payload_offset"], shifted, payload_kg=1.0, **conditions)
    assert after["tip_x_m"][-1] > 0.002
    empty = bench.run(["payload_offset"], shifted, payload_kg=0.0, **conditions)
    assert np.abs(empty["tip_x_m"]).max() < 1e-12


def test_load_offset_is_symmetric_and_shows_in_the_current(bench):
    runs = {s: bench.run(["load_offset"], {"load_offset_1_nm": s * 6.83}) for s in (-1, 0, 1)}
    for sign in (-1, 1):
        change = runs[sign]["current_1_a"] - runs[0]["current_1_a"]
        assert change == pytest.approx(-sign, abs=1e-6)  # pushes up: 1 A less
        assert runs[sign]["angle_1_rad"] == pytest.approx(runs[0]["angle_1_rad"], abs=1e-8)


@pytest.mark.parametrize("offset_nm", [-20.0, 20.0])
def test_a_pull_on_the_joint_presses_the_gear(bench, offset_nm):
    """With it the gear carries |G + T|: friction μ |G + T| where the link alone has μ |G|."""
    effects, share = ["load_dependent_friction", "load_offset"], 0.2
    rise = 0.2 * bench.step_s * np.arange(300)
    change = {}
    for pull in (0.0, offset_nm):
        changes = {"load_offset_1_nm": pull}
        smooth, rough = (
            bench.run(effects, changes | {"load_dependent_friction_1": s}, goal=rise)
            for s in (0.0, share)
        )
        change[pull] = 6.83 * (rough["current_1_a"] - smooth["current_1_a"])[-1]
    load_nm = change[0.0] / share  # rising: friction is positive, and the link falls forwards
    assert load_nm > 3.0
    assert change[offset_nm] == pytest.approx(share * abs(load_nm + offset_nm), rel=0.1)


def test_drag_takes_energy_and_grows_with_the_square(bench):
    time_s = bench.step_s * np.arange(300)
    losses = []
    for amplitude in (0.2, 0.4):
        goal = amplitude * np.sin(2 * time_s)
        runs = [
            bench.run(["aerodynamic_drag"], {"aerodynamic_drag_nm": c}, kind="driven", goal=goal)
            for c in (0.0, 1.0)
        ]
        extra_nm = 6.83 * (runs[1]["current_1_a"] - runs[0]["current_1_a"])[1:]
        rate = np.gradient(goal, bench.step_s)
        assert np.mean(extra_nm * rate) > 0
        losses.append(np.mean(extra_nm * rate))
    assert 6 < losses[1] / losses[0] < 12  # linear drag would give 4, a cubic one 16


# --- bend -----------------------------------------------------------------------------------------


def test_prebend_leans_the_unloaded_link(bench):
    bent = bench.run(["prebend"], {"prebend_1_rad": 0.03}, goal=STILL, payload_kg=0.0)
    other = bench.run(["prebend"], {"prebend_1_rad": -0.03}, goal=STILL, payload_kg=0.0)
    evenly_m = 0.03 * 0.95 / 2  # the link's own weight bends it a little further
    assert evenly_m < bent["tip_x_m"][-1] < 1.2 * evenly_m
    assert bent["tip_x_m"][-1] == pytest.approx(-other["tip_x_m"][-1], rel=1e-9)


def sag_m(bench, effects, changes, goal=HELD, at=-1, **conditions):
    """How far the tip hangs below a rigid link's, across it."""
    run = bench.run(effects, changes, goal=goal, count=len(goal), **conditions)
    angle = run["angle_1_rad"][at]
    return run["tip_x_m"][at] * np.cos(angle) - run["tip_z_m"][at] * np.sin(angle)


def test_stiffness_depends_on_side_size_and_time(bench):
    plain = {s: sag_m(bench, [], {}, s * HELD) for s in (-1, 1)}
    assert plain[1] == pytest.approx(-plain[-1], rel=1e-9)
    side = {"directional_stiffness_1": 0.2}
    assert sag_m(bench, ["directional_stiffness"], side, HELD) < 0.95 * plain[1]
    assert sag_m(bench, ["directional_stiffness"], side, -HELD) < 1.05 * plain[-1] < 0
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


def test_coupling_bends_across(bench):
    goal = np.full(400, 0.3)
    tips = {}
    for sign in (-1, 1):
        run = bench.run(["cross_axis_coupling"], {"coupling_share": sign * 0.2}, dof=2, goal=goal,
                        count=400)  # fmt: skip
        tips[sign] = np.array([run[f"tip_{a}_m"][-1] for a in "xyz"])
    assert tips[1][0] != pytest.approx(tips[-1][0], abs=1e-3)


def test_coupling_bends_a_link_of_one_joint_across_its_plane(bench):
    """By the share of its sag, more by its own weight; to either side, and not without a share."""
    goal, tips = np.full(600, 0.3), {}
    for share in (-0.2, 0.0, 0.2):
        run = bench.run(["cross_axis_coupling"], {"coupling_share": share}, goal=goal, count=600)
        tips[share] = np.array([run[f"tip_{a}_m"][-1] for a in "xy"])
    stiff = bench.run([], {"root_stiffness_1_nm_rad": 1000.0, "span_stiffness_1_nm_rad": 1200.0},
                      goal=goal, count=600)  # fmt: skip
    sag_m = tips[0.0][0] - stiff["tip_x_m"][-1]
    assert tips[0.0][1] == pytest.approx(0.0, abs=1e-9)
    assert tips[0.2][1] == pytest.approx(-tips[-0.2][1], rel=1e-6)
    assert 0.2 * sag_m < abs(tips[0.2][1]) < 0.5 * sag_m
    assert tips[0.2][0] == pytest.approx(tips[-0.2][0], abs=1e-9)


# --- sensors --------------------------------------------------------------------------------------


def test_encoder_offset_turns_the_link_and_hides_itself(bench):
    offset = {"encoder_offset_1_rad": 0.05}
    run = bench.run(["encoder_offset"], offset, goal=np.full(600, 0.05), count=600)
    assert run["angle_1_rad"][-1] == pytest.approx(0.05, abs=1e-6)
    assert run["tip_x_m"][-1] == pytest.approx(0.0, abs=1e-6)  # the servo stands upright


@pytest.mark.parametrize("effects", [["encoder_offset"], ["encoder_offset", "prebend"]])
def test_the_index_is_that_of_noise_where_the_encoder_shows_upright(bench, effects):
    """Its reference is the link at rest, bent by the payload that the offset lets lean."""
    changes = dict.fromkeys((f"{e}_1_rad" for e in effects), 0.05)
    conditions = {"goal": STILL, "payload_kg": 2.0}
    straight = bench.run(effects, **conditions)
    leaning = bench.run(effects, changes, **conditions)
    assert abs(leaning["tip_x_m"][-1]) > 0.02
    assert leaning["di"] == pytest.approx(straight["di"], abs=1e-5)


def test_a_link_with_a_soft_side_starts_at_rest(bench):
    """Its stiffness at a bend is not that of the straight link; the start knows."""
    changes = {"directional_stiffness_1": 0.3, "payload_offset_share": 0.05}
    run = bench.run(
        ["directional_stiffness", "payload_offset"], changes, goal=STILL, payload_kg=2.0
    )
    assert abs(run["tip_x_m"][0]) > 0.002
    assert np.ptp(run["tip_x_m"]) < 1e-5


def test_current_errors_touch_the_current_alone(bench):
    others = ("angle_1_rad", "tip_x_m", "tip_z_m", "di")
    before = bench.run(["current_bias", "current_scale"])
    changes = {"current_bias_1_a": 0.3, "current_scale_1": 0.1}
    after = bench.run(["current_bias", "current_scale"], changes)
    assert after["current_1_a"] == pytest.approx(1.1 * before["current_1_a"] + 0.3, abs=1e-12)
    assert all(np.array_equal(before[name], after[name]) for name in others)


def test_frame_tilt_rotates_the_tip_about_y(bench):
    tilt = 0.1
    before = bench.run(["marker_frame_tilt"])
    after = bench.run(["marker_frame_tilt"], {"marker_frame_tilt_rad": tilt})
    cos, sin = np.cos(tilt), np.sin(tilt)
    turned = cos * before["tip_x_m"] + sin * before["tip_z_m"]
    assert after["tip_x_m"] == pytest.approx(turned, abs=1e-12)
    for name in ("angle_1_rad", "current_1_a", "di"):
        assert np.array_equal(before[name], after[name])


def test_a_turned_frame_turns_the_tip_about_its_three_axes(bench):
    turns = {"roll": 0.05, "tilt": 0.1, "yaw": -0.2}
    before = bench.run(["marker_frame_tilt"])
    after = bench.run(
        ["marker_frame_tilt"], {f"marker_frame_{n}_rad": turn for n, turn in turns.items()}
    )
    tips = [np.column_stack([run[f"tip_{axis}_m"] for axis in "xyz"]) for run in (before, after)]
    rotation = Rotation.from_euler("zxy", [turns["yaw"], turns["roll"], turns["tilt"]])
    assert rotation.apply(tips[0]) == pytest.approx(tips[1], abs=1e-12)


@pytest.mark.parametrize("delay_s", [0.034, -0.034])
def test_sync_offset_delays_the_mocap_alone(bench, delay_s):
    """Two ticks: what the mocap shows is what was, or will be, two rows away."""
    before = bench.run(["sync_offset"])
    after = bench.run(["sync_offset"], {"sync_offset_s": delay_s})
    for name in ("angle_1_rad", "current_1_a"):
        assert np.array_equal(before[name], after[name])
    rows = round(delay_s / bench.step_s)
    true, seen = before["tip_x_m"], after["tip_x_m"]
    error = (seen - np.roll(true, rows))[100:-100]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean((seen - true)[100:-100] ** 2))
    assert not np.array_equal(before["di"], after["di"])
