"""Effects of the command: a late goal, another gain of its loop, lower limits."""

import numpy as np
import pytest


def shift_s(bench, late, early):
    """Delay between two signals by least squares on the derivative."""
    slope = np.gradient(early, bench.step_s)
    return float(-np.dot(late - early, slope) / np.dot(slope, slope))


@pytest.mark.parametrize("dead_s", [0.005, 0.02, 0.06])
def test_dead_time_shifts_every_output_by_its_value(bench, dead_s):
    slow = 0.5 * np.sin(1.44 * bench.step_s * np.arange(600))
    before = bench.run(["dead_time"], goal=slow, count=600)
    after = bench.run(["dead_time"], {"dead_time_1_s": dead_s}, goal=slow, count=600)
    for name in ("angle_1_rad", "tip_x_m"):
        found = shift_s(bench, after[name][200:], before[name][200:])
        assert found == pytest.approx(dead_s, rel=0.02), name


@pytest.mark.parametrize("phase", [0.3, 1.0])
@pytest.mark.parametrize("steps", [1, 2, 3])
def test_a_dead_time_of_whole_steps_is_that_of_goals_sent_later(bench, steps, phase):
    """The saw-tooth of the current is that of a staircase, not of a smoothed one."""
    sent = 0.5 * np.sin(1.44 * bench.step_s * np.arange(600))
    sampled = {"current_phase_1": phase}
    later = bench.run(["dead_time"], sampled, goal=np.r_[np.zeros(steps), sent[:-steps]], count=600)
    delay = {"dead_time_1_s": steps * bench.step_s}
    found = bench.run(["dead_time"], sampled | delay, goal=sent, count=600)
    for name in ("angle_1_rad", "current_1_a", "tip_x_m"):
        error = (found[name] - later[name])[200:].std()
        assert error < 0.02 * later[name][200:].std(), name


def test_the_phase_at_which_a_late_goal_meets_the_sampling_moves_the_current_alone(bench):
    sent = 0.5 * np.sin(1.44 * bench.step_s * np.arange(600))
    cases = [
        {"dead_time_1_s": dead_s, "dead_time_phase_1": shift}
        for dead_s, shift in ((0.0, 0.0), (0.0, -0.5), (0.02, 0.0), (0.02, -0.5))
    ]
    none, none_shifted, late, shifted = (
        bench.run(["dead_time"], case, goal=sent, count=600) for case in cases
    )
    assert np.array_equal(none["current_1_a"], none_shifted["current_1_a"]), "no delay, no phase"
    assert np.array_equal(late["angle_1_rad"], shifted["angle_1_rad"])
    rate = np.gradient(late["angle_1_rad"], bench.step_s)[200:]
    above = (shifted["current_1_a"] - late["current_1_a"])[200:]
    assert np.corrcoef(above, rate)[0, 1] > 0.95, "sooner after a jump the current is larger"


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("change", [-0.4, 0.25])
def test_a_changed_position_gain_is_a_loop_with_that_gain(bench, change, dof):
    effects, known = ["position_gain_change"], bench.plant().parameters
    shaped = {"goal_interpolation_1": 0.4, "current_phase_1": 0.3}
    gain = "position_gain_1_per_s"
    other = shaped | {gain: known[gain].value * (1 + change)}
    wanted = bench.run(effects, other, dof=dof)
    found = bench.run(effects, shaped | {"position_gain_change_1": change}, dof=dof)
    before = bench.run(effects, shaped, dof=dof)
    for name, column in wanted.items():
        np.testing.assert_allclose(found[name], column, rtol=0, atol=1e-9, err_msg=name)
    moved = [np.ptp(found[n] - before[n]) for n in found if n in ("angle_1_rad", "angle_2_rad")]
    assert moved[0] > 1e-3
    assert all(other < 0.1 * moved[0] for other in moved[1:]), "a gain for each servo"


def test_a_step_passes_only_after_the_dead_time(bench):
    step = np.r_[np.zeros(20), np.full(100, 0.2)]
    after = bench.run(["dead_time"], {"dead_time_1_s": 0.102}, goal=step, count=120)
    angle = after["angle_1_rad"]
    assert np.abs(angle[:24]).max() < 0.02 * 0.2  # four steps on their way
    assert angle[-1] == pytest.approx(0.2, abs=0.01)


def test_current_saturation_acts_only_where_it_is_met(bench):
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
    drift = {"torque_constant_drift_1": 0.2}
    before, after = (
        bench.run(["torque_constant_drift"], c, goal=np.full(1500, 0.3), count=1500)
        for c in ({}, drift)
    )
    assert after["current_1_a"][-1] == pytest.approx(before["current_1_a"][-1] / 0.8, rel=1e-3)
    assert after["tip_x_m"][-1] == pytest.approx(before["tip_x_m"][-1], abs=1e-5)
