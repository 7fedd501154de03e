"""Learning from recorded runs: less error on another plant, going back, delays, expectations."""

import hashlib
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.goals.tip_plan import LearnedRun
from firmware_py.safety.limits import Limits
from firmware_py.signals import PERIOD_S
from models.plan.learning import (
    RecordedRun,
    fitting_payload,
    improve_plan,
    interpolated,
    payload_weights,
    read_plan_run,
    unknown_error_m,
)
from models.plan.probing import design_probe
from models.plan.tip_twin import TipTwin
from models.trials.files import write_trial
from models.trials.trial import Trial, TrialMeta

LIMITS = Limits(rate_rad_s=1.0)
PAYLOAD_KG = 0.6


def rms_m(error):
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


@pytest.fixture(scope="module")
def other(plant):
    """A robot with 20 % less stiffness and twice the damping than the plant believes."""
    changed = {
        n: v.value * (0.8 if "_stiffness_" in n else 2.0)
        for n, v in plant.parameters.items()
        if n.endswith(("stiffness_1_nm_rad", "damping_1_nm_s_rad"))
    }
    return TipTwin(plant.with_values(changed).step_model(1), 1, PERIOD_S)


def recorded(robot, plan, number, late=0, payload_kg=PAYLOAD_KG, goals_kg=None, source="mocap"):
    """Run of a plan on a robot, with noise of 0.3 mm, its goals taken up some rows late."""
    goals_kg = payload_kg if goals_kg is None else goals_kg
    goals = interpolated(plan, goals_kg)
    taken = np.concatenate([np.repeat(goals[:1], late, axis=0), goals])[: len(goals)]
    outputs = robot.run(taken, payload_kg)
    noise = np.random.default_rng(number).normal(0.0, 3e-4, (len(goals), 1))
    name = hashlib.sha256(str(number).encode()).hexdigest()
    return RecordedRun(
        goals, robot.angle_rad(outputs), robot.tip_m(outputs) + noise, payload_kg, goals_kg,
        source, name,
    )  # fmt: skip


def true_rms_m(robot, plan, late=0):
    quiet = recorded(robot, plan, 0, late)
    noise = np.random.default_rng(0).normal(0.0, 3e-4, (len(quiet.tip_m), 1))
    return rms_m(quiet.tip_m - noise - plan.desired_tip_m())


def test_learning_removes_what_the_plant_has_wrong(plant, planned, other):
    plan, errors = planned, [true_rms_m(other, planned)]
    for number in (1, 2):
        found = improve_plan(plan, recorded(other, plan, number), plant, LIMITS)
        assert found.run.predicted_rms_m <= found.run.rms_m
        assert found.run.stiffness == pytest.approx(0.8, abs=0.04), "the other robot's"
        assert found.run.damping > 1.1
        plan = found.plan
        errors.append(true_rms_m(other, plan))
    assert errors[0] > 2e-3
    assert errors[1] < errors[0] / 2
    assert errors[2] < 1e-3, "the rest before the motion is not learned"
    assert len(plan.learned) == 2
    rest = round(plan.rest_s / PERIOD_S)
    for table in plan.goals_rad():
        assert not table[:rest].any()
        assert np.abs(table[-1]).max() < 1e-6
    for own in plan.payloads:
        assert rms_m(np.transpose(own.tip_m) - plan.desired_tip_m()) == pytest.approx(
            own.residual_rms_m, abs=2e-6
        )


def test_a_perfect_run_is_left_as_it_is(plant, planned, twin):
    goals = interpolated(planned, 1.0)
    outputs = twin.run(goals, 1.0)
    tip, angle = twin.tip_m(outputs), twin.angle_rad(outputs)
    run = RecordedRun(goals, angle, tip, 1.0, 1.0, "mocap", "0")
    found = improve_plan(planned, run, plant, LIMITS)
    assert np.abs(found.plan.goals_rad() - planned.goals_rad()).max() < 1e-3
    assert found.run.predicted_rms_m <= found.run.rms_m
    assert (found.run.stiffness, found.run.damping) == pytest.approx((1.0, 1.0), abs=1e-3)


def learned_from(run):
    return LearnedRun(
        sha256=run.sha256, source="mocap", payload_kg=run.payload_kg, rms_m=2e-3,
        predicted_rms_m=1e-3, goal_delay_s=0.0, gain=1.0,
        stiffness=1.0, damping=1.0, expected_rms_m=1e-3,
    )  # fmt: skip


def test_a_worse_run_leads_back_to_the_best_one(plant, planned, other):
    first = improve_plan(planned, recorded(other, planned, 1), plant, LIMITS)
    shaken = recorded(other, first.plan, 2)
    shaken = replace(shaken, tip_m=shaken.tip_m + 0.02)
    back = improve_plan(first.plan, shaken, plant, LIMITS)
    assert (back.went_back, back.run.gain) == (True, pytest.approx(1 / 3)), "half of 2/3"
    assert back.plan.best == first.plan.best
    assert true_rms_m(other, back.plan) < true_rms_m(other, planned)


def test_joints_that_follow_late_get_their_goals_earlier_with_every_payload(plant, planned, twin):
    found = improve_plan(planned, recorded(twin, planned, 1, late=1), plant, LIMITS)
    assert found.run.goal_delay_s == pytest.approx(PERIOD_S, rel=0.1)
    assert found.plan.goal_lead_s == found.run.goal_delay_s
    assert true_rms_m(twin, found.plan, late=1) < true_rms_m(twin, planned, late=1) / 5
    other_payload = interpolated(found.plan, 0.0)
    taken = np.concatenate([other_payload[:1], other_payload[:-1]])
    tip = twin.tip_m(twin.run(taken, 0.0))
    assert rms_m(tip - planned.desired_tip_m()) < 2e-3


def test_joints_that_follow_far_too_late_are_refused(plant, planned, twin):
    with pytest.raises(InputError, match="follow 3 periods or more later than the twin's"):
        improve_plan(planned, recorded(twin, planned, 1, late=5), plant, LIMITS)


def test_the_payload_of_a_run_is_found_from_its_goals(planned):
    for payload_kg in (0.0, 0.3, 1.0):
        found, difference = fitting_payload(planned, interpolated(planned, payload_kg))
        assert (found, difference) == (pytest.approx(payload_kg, abs=1e-9), pytest.approx(0.0))
    assert payload_weights(planned, 0.25) == pytest.approx([0.75, 0.25])


def trial_of(twin, goals, directory, name="run", payload_kg=0.5):
    """Trial of two runs, the second with everything 2 % larger, between rests; its path."""
    outputs = twin.run(goals, payload_kg)
    columns = {"goal_1_rad": goals, "angle_1_rad": twin.angle_rad(outputs)}
    columns |= {"current_1_a": twin.current_a(outputs), "tip_x_m": twin.tip_m(outputs)}
    before, after = 37, 21
    rows = before + 2 * len(goals) + after
    table = {"time_s": PERIOD_S * np.arange(rows)}
    for key, own in columns.items():
        twice = np.concatenate([np.zeros(before), own[:, 0], 1.02 * own[:, 0], np.zeros(after)])
        table[key] = twice
    table |= {f"tip_{axis}_m": np.zeros(rows) for axis in "yz"}
    table |= {f"m{i:02d}_{a}_m": np.full(rows, np.nan) for i in range(1, 17) for a in "xyz"}
    meta = TrialMeta(
        dof=1, payload_kg=payload_kg, pressure_pa=41_300.0, trial=1, motion="plan_line",
        source="test", period_s=1.0, amplitude_rad=0.2, base_offset_m=0.05, link_length_m=0.9,
        link_width_m=0.1, rest_samples=10,
    )  # fmt: skip
    return write_trial(Trial(name, meta, table), directory)


def test_a_trial_is_read_from_its_last_whole_run(planned, twin, tmp_path):
    goals = interpolated(planned, 0.5)
    path = trial_of(twin, goals, tmp_path)
    run = read_plan_run(path, planned)
    assert run.tip_m == pytest.approx(1.02 * twin.tip_m(twin.run(goals, 0.5)), abs=1e-5)
    assert (run.source, run.goals_rad.shape) == ("mocap", goals.shape)
    capital = path.rename(path.with_suffix(".CSV"))
    assert read_plan_run(capital, planned).sha256 == run.sha256
    path = capital.rename(path)

    other = msgspec.structs.replace(planned, dof=2)
    with pytest.raises(InputError, match="is of 1 joints, the plan of 2"):
        read_plan_run(path, other)
    with pytest.raises(InputError, match="is no run of the plan line: its goals differ"):
        read_plan_run(trial_of(twin, goals[::-1] ** 2, tmp_path, "other"), planned)


def test_corrections_in_the_goals_are_not_taken_for_payload(planned, twin, tmp_path):
    """Feedback moved the goals as a payload 0.15 kg smaller would; the trial tells 0.5 kg."""
    open_loop = msgspec.structs.replace(planned, feedback=None)
    pulled = interpolated(planned, 0.35) / 1.02
    path = trial_of(twin, pulled, tmp_path)
    assert fitting_payload(planned, 1.02 * pulled)[0] == pytest.approx(0.35)
    run = read_plan_run(path, planned)
    assert (run.payload_kg, run.goals_payload_kg) == (0.5, 0.5)
    estimated = read_plan_run(path, open_loop)
    assert estimated.payload_kg == 0.5, "the mass at the tip, whatever the robot took it for"
    assert estimated.goals_payload_kg == pytest.approx(0.35, abs=1e-4), "nothing was corrected"


def test_a_payload_that_the_robot_took_for_another_does_not_change_the_stiffness(
    plant, planned, other
):
    run = recorded(other, planned, 1, goals_kg=0.3)
    found = improve_plan(planned, run, plant, LIMITS)
    assert found.run.payload_kg == PAYLOAD_KG
    assert found.run.stiffness == pytest.approx(0.8, abs=0.04)
    tip = other.tip_m(other.run(interpolated(found.plan, 0.3), PAYLOAD_KG))
    assert rms_m(tip - planned.desired_tip_m()) < found.run.rms_m / 2, "it takes it so again"


def test_what_motion_capture_told_is_not_left_to_feedback(plant, planned, twin, other):
    assert planned.feedback is not None
    by_mocap, by_robot = (
        improve_plan(planned, recorded(other, planned, 1, source=s), plant, LIMITS).plan
        for s in ("mocap", "observer")
    )
    assert by_mocap.feedback is None
    assert by_robot.feedback == planned.feedback, "the observer's tip is what it leads"
    after = improve_plan(by_robot, recorded(other, by_robot, 2), plant, LIMITS)
    assert (after.went_back, after.run.gain) == (False, 1.0), "the first by motion capture"
    with pytest.raises(InputError, match="would undo what the plan has learned"):
        improve_plan(by_mocap, recorded(other, by_mocap, 2, source="observer"), plant, LIMITS)

    probing = msgspec.structs.replace(planned, probe=design_probe(plant, twin, (0.0, 1.0), LIMITS))
    kept = improve_plan(probing, recorded(other, planned, 1), plant, LIMITS).plan
    assert kept.probe == probing.probe
    assert kept.feedback.size_rad == 0.0, "it probes, and corrects nothing"


def test_the_plants_error_is_gone_at_the_payload_of_the_run_only(plant, planned, twin):
    """From closed forms: correlation exp(-d²/2), and a quarter of the error between two runs."""
    error_m = 2e-3
    plan = msgspec.structs.replace(planned, plant_error_rms_m=error_m)
    run = recorded(twin, plan, 1, payload_kg=0.0)
    known = unknown_error_m(plan, run, [0.0, 0.5, 1.0]) / error_m
    assert known[0] == pytest.approx(0.25, abs=0.01), "runs differ"
    for at_kg, own in ((0.5, known[1]), (1.0, known[2])):
        assert own == pytest.approx(np.sqrt(1 - np.exp(-(at_kg**2)) + 0.25**2), abs=0.01)
    found = improve_plan(plan, run, plant, LIMITS)
    assert found.run.expected_rms_m == pytest.approx(
        np.hypot(found.run.predicted_rms_m, 0.25 * error_m), rel=0.01
    )
    for own, unknown in zip(found.plan.payloads, known[[0, 2]] * error_m, strict=True):
        assert own.expected_rms_m == pytest.approx(np.hypot(own.residual_rms_m, unknown), rel=0.01)
    again = recorded(twin, found.plan, 2, payload_kg=1.0)
    both = unknown_error_m(found.plan, again, [0.0, 0.5, 1.0]) / error_m
    assert both == pytest.approx(0.25, abs=0.1), "between two runs more is known than beyond one"
    assert both[1] < known[1]
    seen = unknown_error_m(plan, replace(run, source="observer"), [0.0])
    assert seen[0] >= error_m, "the observer has the plant's error too"


def test_what_cannot_be_learned_from_is_refused(plant, planned, other):
    run = recorded(other, planned, 1)
    once = msgspec.structs.replace(planned, learned=(learned_from(run),))
    with pytest.raises(InputError, match="was improved by already"):
        improve_plan(once, run, plant, LIMITS)
    with pytest.raises(InputError, match="plan line, improved: row"):
        improve_plan(planned, run, plant, Limits(rate_rad_s=0.05))
