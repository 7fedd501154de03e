"""Learning from recorded runs: less error on another plant, going back, delays, what is refused."""

import hashlib

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.goals.tip_plan import LearnedRun
from firmware_py.safety.limits import Limits
from firmware_py.signals import PERIOD_S
from models.plan.plan_learning import improve_plan
from models.plan.recorded_plan_run import (
    RecordedRun,
    fitting_payload,
    interpolated,
    payload_weights,
    read_plan_run,
)
from models.plan.twin_sensitivity import TipTwin
from models.trials.trial import Trial, TrialMeta
from models.trials.trial_files import write_trial

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


def recorded(robot, plan, number, late=0, payload_kg=PAYLOAD_KG):
    """Run of a plan on a robot, with noise of 0.3 mm, its goals taken up some rows late."""
    goals = interpolated(plan, payload_kg)
    taken = np.concatenate([np.repeat(goals[:1], late, axis=0), goals])[: len(goals)]
    outputs = robot.run(taken, payload_kg)
    noise = np.random.default_rng(number).normal(0.0, 3e-4, (len(goals), 1))
    name = hashlib.sha256(str(number).encode()).hexdigest()
    return RecordedRun(
        goals, robot.angle_rad(outputs), robot.tip_m(outputs) + noise, payload_kg, "mocap", name
    )


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
    run = RecordedRun(goals, twin.angle_rad(outputs), twin.tip_m(outputs), 1.0, "mocap", "0")
    found = improve_plan(planned, run, plant, LIMITS)
    assert np.abs(found.plan.goals_rad() - planned.goals_rad()).max() < 1e-3
    assert found.run.predicted_rms_m <= found.run.rms_m
    assert (found.run.stiffness, found.run.damping) == pytest.approx((1.0, 1.0), abs=1e-3)


def learned_from(run):
    return LearnedRun(
        sha256=run.sha256, source="mocap", payload_kg=run.payload_kg, rms_m=2e-3,
        predicted_rms_m=1e-3, goal_delay_s=0.0, gain=1.0,
    )  # fmt: skip


def test_a_worse_run_leads_back_to_the_best_one(plant, planned, other):
    first = improve_plan(planned, recorded(other, planned, 1), plant, LIMITS)
    shaken = recorded(other, first.plan, 2)
    shaken = RecordedRun(
        shaken.goals_rad, shaken.angle_rad, shaken.tip_m + 0.02, PAYLOAD_KG, "mocap", "2"
    )
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


def test_the_payload_of_a_run_is_found_from_its_goals(planned):
    for payload_kg in (0.0, 0.3, 1.0):
        found, difference = fitting_payload(planned, interpolated(planned, payload_kg))
        assert (found, difference) == (pytest.approx(payload_kg, abs=1e-9), pytest.approx(0.0))
    assert payload_weights(planned, 0.25) == pytest.approx([0.75, 0.25])


def test_a_trial_is_read_from_its_last_whole_run(planned, twin, tmp_path):
    goals = interpolated(planned, 0.5)
    outputs = twin.run(goals, 0.5)
    columns = {"goal_1_rad": goals, "angle_1_rad": twin.angle_rad(outputs)}
    columns |= {"current_1_a": twin.current_a(outputs), "tip_x_m": twin.tip_m(outputs)}
    before, after = 37, 21
    rows = before + 2 * len(goals) + after
    table = {"time_s": PERIOD_S * np.arange(rows)}
    for name, own in columns.items():
        twice = np.concatenate([np.zeros(before), own[:, 0], 1.02 * own[:, 0], np.zeros(after)])
        table[name] = twice
    table |= {f"tip_{axis}_m": np.zeros(rows) for axis in "yz"}
    table |= {f"m{i:02d}_{a}_m": np.full(rows, np.nan) for i in range(1, 17) for a in "xyz"}
    meta = TrialMeta(
        dof=1, payload_kg=0.5, pressure_pa=41_300.0, trial=1, motion="plan_line", source="test",
        period_s=1.0, amplitude_rad=0.2, base_offset_m=0.05, link_length_m=0.9, link_width_m=0.1,
        rest_samples=10,
    )  # fmt: skip
    path = write_trial(Trial("run", meta, table), tmp_path)
    run = read_plan_run(path, planned)
    assert run.tip_m[:, 0] == pytest.approx(1.02 * twin.tip_m(outputs)[:, 0], abs=1e-5)
    assert (run.source, run.goals_rad.shape) == ("mocap", goals.shape)

    other = msgspec.structs.replace(planned, dof=2)
    with pytest.raises(InputError, match="is of 1 joints, the plan of 2"):
        read_plan_run(path, other)
    table["goal_1_rad"] = table["goal_1_rad"][::-1] ** 2
    with pytest.raises(InputError, match="is no run of the plan line: its goals differ"):
        read_plan_run(write_trial(Trial("other", meta, table), tmp_path), planned)


def test_what_cannot_be_learned_from_is_refused(plant, planned, other):
    run = recorded(other, planned, 1)
    once = msgspec.structs.replace(planned, learned=(learned_from(run),))
    with pytest.raises(InputError, match="was improved by already"):
        improve_plan(once, run, plant, LIMITS)
    with pytest.raises(InputError, match="plan line, improved: row"):
        improve_plan(planned, run, plant, Limits(rate_rad_s=0.05))
