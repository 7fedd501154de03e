"""Learning from recorded runs: less error on another plant, going back, delays, expectations."""

from dataclasses import replace
from hashlib import sha256

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.safety.limits import Limits
from models.plan.inversion import rms
from models.plan.learning import (
    RecordedRun,
    improve_plan,
    interpolated,
    read_plan_run,
    unknown_error_m,
)
from models.plan.probing import design_probe
from models.plan.tip_twin import TipTwin
from models.trials.files import write_trial

LIMITS = Limits(rate_rad_s=1.0)
PAYLOAD_KG = 0.6


@pytest.fixture(scope="module")
def other(plant):
    """A robot whose link has 0.8 times the stiffness of the plant and twice the damping."""
    changed = {
        n: v.value * (0.8 if "_stiffness_" in n else 2.0)
        for n, v in plant.parameters.items()
        if n.endswith(("stiffness_1_nm_rad", "damping_1_nm_s_rad"))
    }
    return TipTwin(plant.with_values(changed), 1, PERIOD_S)


def recorded(robot, plan, number, late=0, goals_kg=PAYLOAD_KG, payload_kg=PAYLOAD_KG,
             source="mocap", noise_m=3e-4):  # fmt: skip
    """Run of a plan on a robot that takes its goals up some rows late."""
    goals = interpolated(plan, goals_kg)
    taken = np.concatenate([np.repeat(goals[:1], late, axis=0), goals])[: len(goals)]
    run = robot.run(taken, payload_kg)
    noise = np.random.default_rng(number).normal(0.0, noise_m, run.tip_m.shape)
    name = sha256(str(number).encode()).hexdigest()
    return RecordedRun(goals, run.angle_rad, run.tip_m + noise, payload_kg, goals_kg, source, name)


def true_rms_m(robot, plan, **conditions):
    return rms(recorded(robot, plan, 0, noise_m=0.0, **conditions).tip_m - plan.desired_tip_m())


def test_learning_removes_the_errors_of_the_plant(plant, planned, other):
    plan, errors = planned, [true_rms_m(other, planned)]
    for number in (1, 2):
        plan, went_back = improve_plan(plan, recorded(other, plan, number), plant, LIMITS)
        run = plan.learned[-1]
        assert run.predicted_rms_m <= run.rms_m and not went_back
        assert run.stiffness == pytest.approx(0.8, abs=0.04), "the other robot's"
        assert run.damping > 1.1
        errors.append(true_rms_m(other, plan))
    assert errors[0] > 2e-3
    assert errors[1] < errors[0] / 2
    assert errors[2] < 1e-3, "the rest before the motion is not learned"
    assert len(plan.learned) == 2
    for table in plan.goals_rad():
        assert not table[: round(plan.rest_s / PERIOD_S)].any()
        assert np.abs(table[-1]).max() < 1e-6
    for one in plan.payloads:
        error_m = rms(np.transpose(one.tip_m) - plan.desired_tip_m())
        assert error_m == pytest.approx(one.residual_rms_m, abs=2e-6)


def test_a_perfect_run_changes_nothing(plant, planned, twin):
    run = recorded(twin, planned, 0, goals_kg=1.0, payload_kg=1.0, noise_m=0.0)
    improved, _ = improve_plan(planned, run, plant, LIMITS)
    assert np.abs(improved.goals_rad() - planned.goals_rad()).max() < 1e-3
    learned = improved.learned[-1]
    assert learned.predicted_rms_m <= learned.rms_m
    assert (learned.stiffness, learned.damping) == pytest.approx((1.0, 1.0), abs=1e-3)


def test_a_worse_run_leads_back_to_the_best_one(plant, planned, other):
    first, _ = improve_plan(planned, recorded(other, planned, 1), plant, LIMITS)
    shaken = recorded(other, first, 2)
    back, went_back = improve_plan(first, replace(shaken, tip_m=shaken.tip_m + 0.02), plant, LIMITS)
    assert (went_back, back.learned[-1].gain) == (True, pytest.approx(1 / 3)), "half of 2/3"
    assert back.best == first.best
    assert true_rms_m(other, back) < true_rms_m(other, planned)


def test_joints_that_follow_late_get_their_goals_earlier_with_every_payload(plant, planned, twin):
    improved, _ = improve_plan(planned, recorded(twin, planned, 1, late=1), plant, LIMITS)
    delay_s = improved.learned[-1].goal_delay_s
    assert improved.goal_lead_s == delay_s == pytest.approx(PERIOD_S, rel=0.1)
    assert true_rms_m(twin, improved, late=1) < true_rms_m(twin, planned, late=1) / 5
    assert true_rms_m(twin, improved, late=1, goals_kg=0.0, payload_kg=0.0) < 2e-3


@pytest.fixture
def trial_of(twin, make_trial, tmp_path):
    """Path of a trial of two runs, the second with everything 2 % larger, between rests."""

    def write(goals, name="run"):
        run, before, after = twin.run(goals, 0.5), np.zeros((37, 1)), np.zeros((21, 1))
        goal, angle, tip = (
            np.concatenate([before, table, 1.02 * table, after])
            for table in (run.goals_rad, run.angle_rad, run.tip_m)
        )
        trial = make_trial(angle, step_s=PERIOD_S, payload_kg=0.5, name=name)
        trial.columns.update(goal_1_rad=goal[:, 0], tip_x_m=tip[:, 0])
        return write_trial(trial, tmp_path)

    return write


def test_a_trial_is_read_from_its_last_whole_run(planned, twin, trial_of):
    goals = interpolated(planned, 0.5)
    path = trial_of(goals)
    run = read_plan_run(path, planned)
    assert run.tip_m == pytest.approx(1.02 * twin.run(goals, 0.5).tip_m, abs=1e-5)
    assert (run.source, run.goals_rad.shape) == ("mocap", goals.shape)
    capital = path.rename(path.with_suffix(".CSV"))
    assert read_plan_run(capital, planned).sha256 == run.sha256

    with pytest.raises(InputError, match="is of 1 joints, the plan of 2"):
        read_plan_run(capital, msgspec.structs.replace(planned, dof=2))
    with pytest.raises(InputError, match="is no run of the plan line: its goals differ"):
        read_plan_run(trial_of(goals[::-1] ** 2, "other"), planned)


def test_corrections_in_the_goals_are_not_taken_for_payload(planned, trial_of):
    """Feedback moved the goals as a payload 0.15 kg smaller would; the trial declares 0.5 kg."""
    path = trial_of(interpolated(planned, 0.35) / 1.02)
    run = read_plan_run(path, planned)
    assert (run.payload_kg, run.goals_payload_kg) == (0.5, 0.5)
    run = read_plan_run(path, msgspec.structs.replace(planned, feedback=None))
    assert run.payload_kg == 0.5, "the mass at the tip, whatever the robot estimated"
    assert run.goals_payload_kg == pytest.approx(0.35, abs=1e-4), "nothing was corrected"


def test_a_wrong_estimate_of_the_payload_does_not_change_the_stiffness(plant, planned, other):
    run = recorded(other, planned, 1, goals_kg=0.3)
    improved, _ = improve_plan(planned, run, plant, LIMITS)
    assert improved.learned[-1].payload_kg == PAYLOAD_KG
    assert improved.learned[-1].stiffness == pytest.approx(0.8, abs=0.04)
    after_m = true_rms_m(other, improved, goals_kg=0.3)
    assert after_m < improved.learned[-1].rms_m / 2, "with the same wrong estimate"


@pytest.mark.slow
def test_learning_from_motion_capture_removes_feedback(plant, planned, twin, other):
    assert planned.feedback is not None
    by_mocap, by_robot = (
        improve_plan(planned, recorded(other, planned, 1, source=s), plant, LIMITS)[0]
        for s in ("mocap", "observer")
    )
    assert by_mocap.feedback is None
    assert by_robot.feedback == planned.feedback
    after, went_back = improve_plan(by_robot, recorded(other, by_robot, 2), plant, LIMITS)
    assert (went_back, after.learned[-1].gain) == (False, 1.0), "the first by motion capture"
    with pytest.raises(InputError, match="would undo what the plan has learned"):
        improve_plan(by_mocap, recorded(other, by_mocap, 2, source="observer"), plant, LIMITS)

    probing = msgspec.structs.replace(planned, probe=design_probe(plant, twin, (0.0, 1.0), LIMITS))
    improved, _ = improve_plan(probing, recorded(other, planned, 1), plant, LIMITS)
    assert improved.probe == probing.probe
    assert improved.feedback.size_rad == 0.0, "it probes, and corrects nothing"


def test_the_plants_error_is_known_only_near_the_payload_of_the_run(plant, planned, twin):
    """From closed forms: correlation exp(-d²/2), and a quarter of the error between two runs."""
    error_m = 2e-3
    plan = msgspec.structs.replace(planned, plant_error_rms_m=error_m)
    run = recorded(twin, plan, 1, goals_kg=0.0, payload_kg=0.0)
    apart_kg = np.array([0.0, 0.5, 1.0])
    unknown = unknown_error_m(plan, run, apart_kg) / error_m
    assert unknown == pytest.approx(np.sqrt(1 - np.exp(-(apart_kg**2)) + 0.25**2), abs=0.01)
    improved, _ = improve_plan(plan, run, plant, LIMITS)
    for one, off_m in zip(
        (*improved.payloads, improved.learned[-1]), unknown[[0, 2, 0]] * error_m, strict=True
    ):
        alone_m = getattr(one, "residual_rms_m", None) or one.predicted_rms_m
        assert one.expected_rms_m == pytest.approx(np.hypot(alone_m, off_m), rel=0.01)
    again = recorded(twin, improved, 2, goals_kg=1.0, payload_kg=1.0)
    both = unknown_error_m(improved, again, apart_kg) / error_m
    assert both == pytest.approx(0.25, abs=0.1), "between two runs more is known than beyond one"
    assert both[1] < unknown[1]
    observed = unknown_error_m(plan, replace(run, source="observer"), 0.0)
    assert observed >= error_m, "the observer has the plant's error too"


def test_runs_that_cannot_be_learned_from_are_refused(plant, planned, twin):
    run = recorded(twin, planned, 1)
    improved, _ = improve_plan(planned, run, plant, LIMITS)
    with pytest.raises(InputError, match="was improved by already"):
        improve_plan(improved, run, plant, LIMITS)
    with pytest.raises(InputError, match="plan line, improved: row"):
        improve_plan(planned, run, plant, Limits(rate_rad_s=0.05))
    with pytest.raises(InputError, match="follow 3 periods or more later than the twin's"):
        improve_plan(planned, recorded(twin, planned, 1, late=5), plant, LIMITS)
