"""Plans on the robot's loop: goals as planned, tip on its path, robots that a plan does not fit."""

import hashlib
import json

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.plan_goals import PlanGoals
from firmware_py.goals.tip_plan import read_tip_plan
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.estimator import Estimate, NoEstimator
from firmware_py.inference.manifest import MANIFEST
from firmware_py.log.recording import read_recording
from firmware_py.safety.estimate_trust import TrustState
from firmware_py.safety.limits import Limits
from hil.commands.sil import describe_sil
from hil.emulator.physics import build_twin
from hil.sil import SilOptions, run_sil, write_results
from hil.sil.sil_loop import LOG_NAME
from models.plan.learning import improve_plan, read_plan_run
from models.plan.paths import PathOptions, built_in_path
from models.plan.planning import PlanRequest, plan_path
from models.plant.plant import NOMINAL, read_plant
from models.trials.files import read_trial
from tests.hil.sil.test_sil import RigidPredictor


class Weighing(NoEstimator):
    """Estimates that jump from one end of the range to the other."""

    ticks = 0

    def update(self, angle_rad, current_a, step_s):
        self.ticks += 1
        return Estimate(0.0, 0.0 if self.ticks % 100 < 50 else 2.0)


class UnbentPredictor(RigidPredictor):
    """Knows no bend, and takes the innovation of the current."""

    wanted = ("innovation_1_a",)


class Unsurprised(NoEstimator):
    """Estimates nothing, and is never surprised."""

    def update(self, angle_rad, current_a, step_s):
        return Estimate(0.0, 0.0, np.zeros(1))


class Heavy(NoEstimator):
    """Estimates more than the plan holds, and is surprised by every current."""

    def update(self, angle_rad, current_a, step_s):
        return Estimate(0.0, 2.0, np.full(1, 9.0))


@pytest.fixture(scope="module")
def bundle(bare_bundle):
    manifest = read_manifest(bare_bundle)
    sha256 = hashlib.sha256((bare_bundle / MANIFEST).read_bytes()).hexdigest()
    return ModelBundle(bare_bundle, manifest, Unsurprised(), UnbentPredictor(), sha256)


@pytest.fixture(scope="module")
def plan(bundle):
    path = built_in_path("line", 1, PERIOD_S, PathOptions(size_m=0.2, seconds=2.0))
    sha256 = bundle.manifest_sha256
    return plan_path(
        path, PlanRequest(read_plant(), 1, PERIOD_S, Limits(rate_rad_s=1.0), (0.5, 1.5), sha256)
    )


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return build_twin(NOMINAL, 1, tmp_path_factory.mktemp("twin"))


@pytest.fixture
def options(bundle, plan, fmu, tmp_path):
    def build(**changes):
        given = {
            "bundle": bundle, "model": MODELS[54024], "out": tmp_path, "fmu": fmu,
            "line": "virtual", "seconds": plan.duration_s, "payload_kg": 0.8,
            "payload_known": True, "plan": plan, "open_loop": True,
        }  # fmt: skip
        return SilOptions(**(given | changes))

    return build


def test_the_robot_sends_the_planned_goals_and_learns_from_the_run(options, bundle, plan, tmp_path):
    chosen = options(seconds=2 * plan.duration_s)
    result = run_sil(chosen)
    own = result.records[result.records["tick"] >= 0]
    goals = PlanGoals(plan, 0.8)
    wanted = np.array([goals.at(slot)[0] for slot in range(2 * plan.rows)])
    assert np.array_equal(own["goal_1_rad"][: len(wanted)], wanted)

    timing = write_results(result, chosen)
    assert len(timing.path_errors) == 2
    for error in timing.path_errors:
        assert error.rows == plan.rows
        assert error.rms_m < plan.payloads[0].rigid_rms_m / 8, "the line adds a delay"
        assert error.rms_m <= error.max_m
    trial = read_trial(tmp_path / "trial" / "sil.csv")
    assert (trial.meta.motion, trial.meta.rest_samples) == ("plan_line", round(1 / PERIOD_S))
    log = read_recording(tmp_path / LOG_NAME)
    assert json.loads(log.metadata["motion"])["motion"] == "plan_line"
    by_mocap, by_robot = (
        read_plan_run(tmp_path / name, plan) for name in ("trial/sil.csv", LOG_NAME)
    )
    assert (by_mocap.source, by_robot.source) == ("mocap", "observer")
    assert by_mocap.payload_kg == by_robot.payload_kg == pytest.approx(0.8, abs=1e-6)
    assert by_robot.goals_rad[:, 0] == pytest.approx(wanted[plan.rows :], abs=1e-9)
    assert by_mocap.goals_rad[:, 0] == pytest.approx(wanted[plan.rows :], abs=1e-6)
    _improve(bundle, plan, tmp_path, timing.path_errors[-1].rms_m)


def _improve(bundle, plan, directory, measured_m):
    write_document(directory / "plan.json", plan)
    words = [
        "plan", directory / "plan.json", "--improve", directory / "trial" / "sil.csv", "--plant",
        NOMINAL, "--bundle", bundle.directory, "--out", directory / "next.json",
    ]  # fmt: skip
    assert main([str(w) for w in words]) == 0
    improved = read_tip_plan(directory / "next.json")
    assert improved.learned[0].rms_m == pytest.approx(measured_m, rel=0.02)
    assert improved.learned[0].predicted_rms_m < measured_m / 2
    assert (directory / "next.svg").stat().st_size > 1000


def test_corrections_of_a_wrong_estimate_stay_within_their_bounds(options, plan):
    """A predictor that knows no bend asks for more than the bounds give."""
    result = run_sil(options(open_loop=False))
    assert result.summary.reason == "the motion is over"
    own = result.records[(result.records["tick"] >= 0) & (result.records["tick"] < plan.rows)]
    goals = PlanGoals(plan, 0.8)
    added = own["goal_1_rad"] - np.array([goals.at(int(k))[0] for k in own["tick"]])
    assert set(own["trust"]) == {TrustState.TRUSTED}
    assert 1e-3 < np.max(np.abs(added)) <= plan.feedback.size_rad + 1e-9
    assert np.max(np.abs(np.diff(added))) <= plan.feedback.rate_rad_s * PERIOD_S + 1e-9


def test_a_plan_improved_by_motion_capture_is_as_good_as_it_says_with_a_wrong_observer(
    options, plan, tmp_path
):
    """Default set-up: the observer's tip is wrong by the bend, motion capture sees the true one."""
    chosen = options(open_loop=False)
    before = write_results(run_sil(chosen), chosen).path_errors[-1].rms_m
    recorded = read_plan_run(tmp_path / "trial" / "sil.csv", plan)
    assert (recorded.payload_kg, recorded.goals_payload_kg) == (0.8, 0.8)
    improved, _ = improve_plan(plan, recorded, read_plant(), Limits(rate_rad_s=1.0))
    chosen = options(open_loop=False, plan=improved, seconds=improved.duration_s)
    after = write_results(run_sil(chosen), chosen).path_errors[-1].rms_m
    assert after < before / 4
    assert after < 1.1 * improved.learned[-1].expected_rms_m


def test_a_payload_beyond_the_plan_and_lost_feedback_are_told(options, bundle, plan, tmp_path):
    heavy = ModelBundle(
        bundle.directory, msgspec.structs.replace(bundle.manifest, estimator="observer"),
        Heavy(), bundle.predictor, bundle.manifest_sha256,
    )  # fmt: skip
    chosen = options(bundle=heavy, payload_known=False, open_loop=False)
    timing = write_results(run_sil(chosen), chosen)
    told = describe_sil(timing, tmp_path).splitlines()
    note = timing.run.payload_note
    assert "2.00 kg" in note and "0.5 to 1.5 kg" in note
    used = timing.run.feedback
    assert (used.ticks, used.lost_ticks) == (plan.rows, plan.rows - 1), "two bad ticks end trust"
    assert {timing.run.payload_note, used.note} <= set(told)
    assert "innovation is 9.00 A" in used.note


def test_an_estimate_that_jumps_trips_no_limit(options, bundle, plan):
    weighing = ModelBundle(
        bundle.directory, msgspec.structs.replace(bundle.manifest, estimator="observer"),
        Weighing(), bundle.predictor, bundle.manifest_sha256,
    )  # fmt: skip
    result = run_sil(options(bundle=weighing, payload_known=False))
    assert not result.summary.reason.startswith("the goal"), result.summary.reason
    assert result.summary.ended.value == "finished"
    sent = result.records["goal_1_rad"]
    low, high = (table[:, 0] for table in plan.goals_rad())
    inside = result.records["tick"] >= 0
    slot = np.minimum(result.records["tick"][inside], plan.rows - 1)
    assert np.all(sent[inside] >= np.minimum(low, high)[slot] - 1e-9)
    assert np.all(sent[inside] <= np.maximum(low, high)[slot] + 1e-9)


@pytest.mark.parametrize(
    ("changes", "robot", "sentence"),
    [
        ({"bundle_sha256": "0"}, {}, "was made for another bundle"),
        ({"period_s": 0.02}, {}, r"has a period of 0\.02 s, the robot 0\.017 s"),
        ({}, {"payload_known": False}, "needs the payload, which the estimator 'none'"),
        ({}, {"payload_kg": 2.5}, r"payload_kg: is 2\.5 kg, the plan line holds 0\.5 to 1\.5 kg"),
    ],
)
def test_a_plan_that_does_not_fit_the_robot_is_refused(options, plan, changes, robot, sentence):
    other = msgspec.structs.replace(plan, **changes)
    with pytest.raises(InputError, match=sentence):
        run_sil(options(plan=other, **robot))


def test_a_plan_for_another_number_of_joints_is_refused(options, plan):
    twice = msgspec.structs.replace(plan, dof=2, desired_m=plan.desired_m * 2)
    with pytest.raises(InputError, match="is for 2 joints, the robot has 1"):
        run_sil(options(plan=twice))


def test_a_file_that_is_no_plan_gets_one_sentence(bundle, plan, tmp_path, capsys):
    write_document(tmp_path / "plan.json", msgspec.structs.replace(plan, payloads=()))
    arguments = ["sil", "--bundle", bundle.directory, "--out", tmp_path / "out"]
    code = main([str(a) for a in (*arguments, "--plan", tmp_path / "plan.json")])
    output = capsys.readouterr()
    assert code == 2
    assert "plan.json: has no payload; write it anew with dropstitch plan" in output.err
