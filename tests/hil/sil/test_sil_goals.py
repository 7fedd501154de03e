"""Goals in software: plans, their probing motion, and the goals of another program."""

import contextlib
import dataclasses
import hashlib
import json
import threading
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.servo_models import MODELS
from firmware_py.commands.replay import compare
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.for_robot import outside_goals
from firmware_py.goals.goal_channel import connect
from firmware_py.goals.plan_goals import PlanGoals
from firmware_py.goals.tip_plan import read_tip_plan
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.estimator import Estimate, NoEstimator, ObserverEstimator
from firmware_py.inference.manifest import MANIFEST
from firmware_py.log.recording import read_recording
from firmware_py.safety.estimate_trust import TrustState
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from hil.commands.sil import describe_sil
from hil.sil import LOG_NAME, SilOptions, run_sil
from hil.sil.sil_options import sil_config
from hil.sil.tip_errors import CLOSE_M, move_figures
from models.plan.learning import improve_plan, read_plan_run
from models.plan.paths import PathOptions, built_in_path
from models.plan.plan import PlanRequest, plan_path
from models.plant.plant import NOMINAL, read_plant
from models.trials.files import read_trial
from tests.firmware_py.goals.scripted_program import linear_map, swinging
from tests.hil.sil.test_sil import Interrupter, RigidPredictor

PAYLOAD_KG = 0.8


class UnbentPredictor(RigidPredictor):
    """Predicts no bend, and takes the innovation of the current."""

    wanted = ("innovation_1_a",)


class Constant(NoEstimator):
    """Estimates the same payload and innovation in every tick."""

    def __init__(self, payload_kg: float, innovation_a: float) -> None:
        self.estimate = Estimate(0.0, payload_kg, np.full(1, innovation_a))

    def update(self, angle_rad, current_a, step_s):
        return self.estimate


class Jumping(NoEstimator):
    """Estimates a payload that jumps from one end of the range to the other."""

    ticks = 0

    def update(self, angle_rad, current_a, step_s):
        self.ticks += 1
        return Estimate(0.0, 0.0 if self.ticks % 100 < 50 else 2.0)


class Converging(ObserverEstimator):
    """Estimates a payload that falls from sample to sample, unless it is assumed."""

    def __init__(self):
        self.assumed, self._payload_kg = [], None
        self.reset()

    def reset(self):
        self._samples = 0

    def assume_payload(self, payload_kg):
        self._payload_kg = payload_kg
        self.assumed.append(payload_kg)
        self.reset()

    def update(self, angle_rad, current_a, step_s):
        self._samples += 1
        estimated_kg = 1.5 - 1e-3 * self._samples
        payload_kg = estimated_kg if self._payload_kg is None else self._payload_kg
        return Estimate(0.0, payload_kg, np.zeros(1))


@pytest.fixture(scope="module")
def bundle(bare_bundle):
    manifest = read_manifest(bare_bundle)
    sha256 = hashlib.sha256((bare_bundle / MANIFEST).read_bytes()).hexdigest()
    return ModelBundle(bare_bundle, manifest, Constant(0.0, 0.0), UnbentPredictor(), sha256)


def with_observer(bundle, estimator):
    manifest = msgspec.structs.replace(bundle.manifest, estimator="observer")
    return dataclasses.replace(bundle, manifest=manifest, estimator=estimator)


def line_plan(bundle, size_m, limits, **options):
    path = built_in_path("line", 1, PERIOD_S, PathOptions(size_m=size_m, seconds=2.0))
    sha256 = bundle.manifest_sha256
    request = PlanRequest(read_plant(), 1, PERIOD_S, limits, (0.5, 1.5), sha256, **options)
    return plan_path(path, request)


@pytest.fixture(scope="module")
def plan(bundle):
    return line_plan(bundle, 0.2, Limits(rate_rad_s=1.0))


@pytest.fixture(scope="module")
def probing_plan(bundle):
    return line_plan(bundle, 0.1, Limits(), probe=True)


@pytest.fixture
def options(bundle, plan, twins, tmp_path):
    def build(**changes):
        defaults = {
            "bundle": bundle, "model": MODELS[54024], "out": tmp_path, "fmu": twins[1],
            "line": "virtual", "payload_kg": PAYLOAD_KG, "payload_known": True, "plan": plan,
            "open_loop": True,
        }  # fmt: skip
        return SilOptions(**(defaults | changes))

    return build


@pytest.mark.slow
def test_the_robot_sends_the_planned_goals_and_learns_from_the_run(options, bundle, plan, tmp_path):
    chosen = options(runs=2)
    result = run_sil(chosen)
    motion = result.records[result.records["tick"] >= 0]
    goals = PlanGoals(plan, PAYLOAD_KG)
    wanted = np.array([goals.at(slot)[0] for slot in range(2 * plan.rows)])
    assert np.array_equal(motion["goal_1_rad"][: len(wanted)], wanted)

    result.write()
    timing = result.timing
    assert len(timing.path_errors) == 2
    for error in timing.path_errors:
        assert error.rows == plan.rows
        assert error.rms_m < plan.payloads[0].rigid_rms_m / 8, "the line adds a delay"
        assert error.rms_m <= error.max_m
    trial = read_trial(tmp_path / "trial" / "sil.csv")
    assert (trial.meta.motion, trial.meta.rest_samples) == ("plan_line", round(1 / PERIOD_S))
    by_mocap, by_robot = (
        read_plan_run(tmp_path / name, plan) for name in ("trial/sil.csv", LOG_NAME)
    )
    assert (by_mocap.source, by_robot.source) == ("mocap", "observer")
    assert by_mocap.payload_kg == by_robot.payload_kg == pytest.approx(PAYLOAD_KG, abs=1e-6)
    assert by_robot.goals_rad[:, 0] == pytest.approx(wanted[plan.rows :], abs=1e-9)
    assert by_mocap.goals_rad[:, 0] == pytest.approx(wanted[plan.rows :], abs=1e-6)

    write_document(tmp_path / "plan.json", plan)
    words = [
        "plan", tmp_path / "plan.json", "--improve", tmp_path / "trial" / "sil.csv", "--plant",
        NOMINAL, "--bundle", bundle.directory, "--out", tmp_path / "next.json",
    ]  # fmt: skip
    assert main([str(w) for w in words]) == 0
    learned, measured_m = read_tip_plan(tmp_path / "next.json").learned[0], error.rms_m
    assert learned.rms_m == pytest.approx(measured_m, rel=0.02)
    assert learned.predicted_rms_m < measured_m / 2
    assert (tmp_path / "next.svg").stat().st_size > 1000


def test_corrections_of_a_wrong_estimate_stay_within_their_bounds(options, plan):
    """A predictor without bend asks for more than the bounds allow."""
    result = run_sil(options(open_loop=False))
    assert result.summary.reason == "the motion is over"
    motion = result.records[(result.records["tick"] >= 0) & (result.records["tick"] < plan.rows)]
    goals = PlanGoals(plan, PAYLOAD_KG)
    added = motion["goal_1_rad"] - np.array([goals.at(int(k))[0] for k in motion["tick"]])
    assert set(motion["trust"]) == {TrustState.TRUSTED}
    assert 1e-3 < np.max(np.abs(added)) <= plan.feedback.size_rad + 1e-9
    assert np.max(np.abs(np.diff(added))) <= plan.feedback.rate_rad_s * PERIOD_S + 1e-9


@pytest.mark.slow
def test_a_plan_improved_by_motion_capture_reaches_its_expected_error_with_a_wrong_observer(
    options, plan, tmp_path
):
    """The observer's tip is wrong by the bend, motion capture measures the true one."""
    chosen = options(open_loop=False)
    result = run_sil(chosen)
    result.write()
    before = result.timing.path_errors[-1].rms_m
    recorded = read_plan_run(tmp_path / "trial" / "sil.csv", plan)
    assert (recorded.payload_kg, recorded.goals_payload_kg) == (PAYLOAD_KG, PAYLOAD_KG)
    improved, _ = improve_plan(plan, recorded, read_plant(), Limits(rate_rad_s=1.0))
    chosen = options(open_loop=False, plan=improved)
    after = run_sil(chosen).timing.path_errors[-1].rms_m
    assert after < before / 4
    assert after < 1.1 * improved.learned[-1].expected_rms_m


def test_a_payload_beyond_the_plan_and_lost_feedback_are_reported(options, bundle, plan, tmp_path):
    heavy = with_observer(bundle, Constant(2.0, 9.0))
    chosen = options(bundle=heavy, payload_known=False, open_loop=False)
    timing = run_sil(chosen).timing
    note = timing.run.payload_note
    assert "2.00 kg" in note and "0.5 to 1.5 kg" in note
    feedback = timing.run.feedback
    assert (feedback.ticks, feedback.lost_ticks) == (plan.rows, plan.rows - 1)
    assert "innovation is 9.00 A" in feedback.note
    assert {note, feedback.note} <= set(describe_sil(timing, tmp_path).splitlines())


def test_an_estimate_that_jumps_trips_no_limit(options, bundle, plan):
    result = run_sil(options(bundle=with_observer(bundle, Jumping()), payload_known=False))
    assert result.summary.ended.value == "finished", result.summary.reason
    low, high = (table[:, 0] for table in plan.goals_rad())
    inside = result.records["tick"] >= 0
    sent = result.records["goal_1_rad"][inside]
    slot = np.minimum(result.records["tick"][inside], plan.rows - 1)
    assert np.all(sent >= np.minimum(low, high)[slot] - 1e-9)
    assert np.all(sent <= np.maximum(low, high)[slot] + 1e-9)


@pytest.mark.parametrize(
    ("changes", "robot", "sentence"),
    [
        ({"bundle_sha256": "0"}, {}, "was made for another bundle"),
        ({"period_s": 0.02}, {}, r"has a period of 0\.02 s, the robot 0\.017 s"),
        ({}, {"payload_known": False}, "needs the payload, which the estimator 'none'"),
        ({}, {"payload_kg": 2.5}, r"payload_kg: is 2\.5 kg, the plan line holds 0\.5 to 1\.5 kg"),
        ({"dof": 2}, {}, "is for 2 joints, the robot has 1"),
    ],
)
def test_a_plan_that_does_not_fit_the_robot_is_refused(options, plan, changes, robot, sentence):
    other = msgspec.structs.replace(plan, **changes)
    if other.dof == 2:
        other = msgspec.structs.replace(other, desired_m=plan.desired_m * 2)
    with pytest.raises(InputError, match=sentence):
        run_sil(options(plan=other, **robot))


@pytest.fixture
def probing(options, bundle, probing_plan):
    def build(**changes):
        defaults = {
            "bundle": with_observer(bundle, Converging()), "model": MODELS[54025],
            "plan": probing_plan, "payload_known": False, "open_loop": False,
        }  # fmt: skip
        return options(**(defaults | changes))

    return build


def test_the_probing_motion_precedes_the_plan_and_measures_the_payload(probing, tmp_path):
    chosen = probing()
    result, plan, observer = run_sil(chosen), chosen.plan, chosen.bundle.estimator
    assert result.summary.reason == "the motion is over"
    records = result.records
    before = records[(records["tick"] >= -plan.probe.rows) & (records["tick"] < 0)]
    assert before["goal_1_rad"] == pytest.approx(plan.probe.goals_rad[0], abs=1e-9)
    assert np.all(records["goal_1_rad"][records["tick"] < -plan.probe.rows] == 0.0)
    assert observer.assumed[0] is None
    assert observer.assumed[1] == pytest.approx(PAYLOAD_KG, abs=0.1)
    assert records["payload_kg"][-1] == observer.assumed[1]
    errors = result.timing.path_errors
    assert [e.rows for e in errors] == [plan.rows], "the rows of the probe are not on the path"
    approach = result.timing.prediction_error.parts["approach"]
    assert approach.n == np.count_nonzero(records["tick"] < 0)
    trial = result.trial()
    at_rest = trial.goal_rad[: trial.meta.rest_samples]
    assert len(at_rest) == round(plan.rest_s / PERIOD_S) and np.ptp(at_rest) < 1e-4
    log = read_recording(tmp_path / LOG_NAME)
    assert max(compare(log, chosen.bundle).values()) < 1e-12
    assert read_plan_run(tmp_path / LOG_NAME, plan).source == "observer"


def test_a_run_that_ended_in_its_probing_motion_is_no_trial(probing, bundle, tmp_path):
    predictor = Interrupter(10)
    predictor.wanted = UnbentPredictor.wanted
    observed = with_observer(bundle, Converging())
    result = run_sil(probing(bundle=dataclasses.replace(observed, predictor=predictor)))
    assert len(result.records) and np.all(result.records["tick"] < 0)
    result.write()
    assert not (tmp_path / "trial").exists()
    with pytest.raises(InputError, match="ended before its motion"):
        result.trial()


def test_a_robot_without_feedback_does_not_probe(probing, tmp_path):
    chosen = probing(open_loop=True, payload_known=True)
    records = run_sil(chosen).records
    assert np.all(records["goal_1_rad"][records["tick"] < 0] == 0.0)
    assert chosen.bundle.estimator.assumed == [PAYLOAD_KG]
    assert max(compare(read_recording(tmp_path / LOG_NAME), chosen.bundle).values()) < 1e-12


def test_after_stale_data_in_the_probe_the_observer_estimates_the_payload(probing, tmp_path):
    chosen = probing(faults={"lost": 0.15}, seed=1)
    result = run_sil(chosen)
    assert result.summary.reason == "the motion is over"
    assert SafetyState.DEGRADED in result.records["state"][result.records["tick"] < 0]
    assert chosen.bundle.estimator.assumed == [None, None]
    assert max(compare(read_recording(tmp_path / LOG_NAME), chosen.bundle).values()) < 1e-12


TICKS = 60


def program(address):
    """Connect to a robot that may not listen yet, swing for some ticks, then end the run."""
    connection = None
    while connection is None:
        with contextlib.suppress(InputError):
            connection = connect(address)
    with connection:
        while data := connection.recv(4096):
            status = json.loads(data)
            over = status["tick"] >= TICKS
            goals = {"tick": status["tick"], "end": True} if over else swinging(status)
            connection.send(json.dumps(goals).encode())
            if over:
                return


def test_the_run_follows_the_goals_of_another_program(options, tmp_path):
    address, alone = f"unix:{tmp_path}/goals", options(plan=None, seconds=3.0)
    thread = threading.Thread(target=program, args=(address,))
    thread.start()
    config = sil_config(alone, "virtual")
    with outside_goals(address, None, config, alone.bundle, patience_s=5.0) as goals:
        chosen = dataclasses.replace(alone, goals=goals)
        result = run_sil(chosen)
    result.write()
    timing = result.timing
    thread.join()
    assert timing.run.programme_s == {"motion": 3.0}
    motion = result.records[result.records["tick"] >= 1][: TICKS - 2]
    wanted = [
        swinging({"tick": 0, "time_s": (k - 1) * 0.017})["joint_rad"][0] for k in motion["tick"]
    ]
    assert motion["goal_1_rad"] == pytest.approx(wanted, abs=1e-9)
    trial = read_trial(tmp_path / "trial" / "sil.csv")
    assert trial.meta.motion == "outside"
    assert trial.meta.amplitude_rad == np.abs(trial.goal_rad).max() > 0.05
    moving = len(trial) - trial.meta.rest_samples
    assert trial.meta.period_s == pytest.approx(moving * trial.step_s, abs=0.018)
    log = read_recording(tmp_path / LOG_NAME)
    assert json.loads(log.metadata["motion"]) == {"motion": "outside"}


@pytest.mark.parametrize(
    ("options", "option"),
    [
        ("--goal-map P.json", "--goal-map"),
        ("--hide creep=0.1", "--hide"),
        ("--open-loop", "--open-loop"),
    ],
    ids=["map without goals", "hidden effect without rig", "open loop without plan"],
)
def test_options_that_need_another_one_are_refused(tmp_path, capsys, options, option):
    words = f"sil --bundle {tmp_path} --out {tmp_path}/out --line virtual {options}"
    assert main(words.split()) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"dropstitch: {option}") and error.count("\n") == 1


def test_a_map_for_another_robot_is_refused(options, tmp_path):
    chosen = options(plan=None)
    config = sil_config(chosen, "virtual")
    write_document(tmp_path / "map.json", linear_map(2))
    goals = outside_goals(f"unix:{tmp_path}/goals", tmp_path / "map.json", config, chosen.bundle)
    with pytest.raises(InputError, match="is for 2 joints, the robot has 1"), goals:
        pass


def test_the_motion_of_the_study_is_within_the_limits_at_a_shorter_period(options, bundle):
    manifest = msgspec.structs.replace(bundle.manifest, period_s=0.01)
    chosen = options(plan=None, bundle=replace(bundle, manifest=manifest), open_loop=False)
    goals_rad = sil_config(chosen, "virtual").goals_rad()
    assert np.abs(goals_rad).max() == pytest.approx(np.radians(30.0), abs=1e-3)


def plan_with_moves(plan, desired_m, moves):
    return msgspec.structs.replace(
        plan, period_s=0.01, desired_m=(tuple(desired_m),), moves=moves, end_row=len(desired_m)
    )


def test_a_decaying_swing_settles_when_its_envelope_enters_the_band(plan):
    time_s = 0.01 * np.arange(1000)
    swing = 0.1 * np.exp(-time_s) * np.cos(2 * np.pi * 2.0 * time_s)
    tip = (0.3 + swing)[:, None]
    (move,) = move_figures(tip, plan_with_moves(plan, np.full(1000, 0.31), ((0, 50, 1000),)))
    assert move.settling_s == pytest.approx(np.log(0.1 / CLOSE_M), abs=0.25)
    assert move.swing_m == pytest.approx(0.1 * np.exp(-0.5), rel=0.15)
    assert move.offset_m == pytest.approx(0.01, abs=1e-4)
    assert move.command_s == pytest.approx(0.5)


def test_ticks_without_a_measurement_do_not_count_in_a_move(plan):
    tip = np.full((100, 1), 0.2)
    tip[40] = np.nan
    (move,) = move_figures(tip, plan_with_moves(plan, np.full(100, 0.2), ((0, 10, 100),)))
    assert (move.settling_s, move.swing_m, move.offset_m) == (0.0, 0.0, pytest.approx(0.0))
