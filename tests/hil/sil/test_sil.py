"""Runs of the robot's loop against emulated servos with the nominal plant behind them."""

import json
import math
import signal
import time
import tomllib
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.commands.replay import compare
from firmware_py.core.errors import InputError
from firmware_py.core.motion import MotionConfig
from firmware_py.core.output_files import locked_directory
from firmware_py.core.signals import tick_dtype
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.estimator import Estimate, NoEstimator
from firmware_py.inference.manifest import write_manifest
from firmware_py.inference.predictor import Prediction
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.log.recording import read_recording
from firmware_py.safety.states import Fault, SafetyState
from firmware_py.summary import Ended
from firmware_py.system.timing import Cause
from fmu.fmu_builder import build_fmu
from hil.commands.sil import describe_sil
from hil.emulator.emulator import Truth
from hil.emulator.physics import RigSource
from hil.sil import SilOptions, run_sil
from hil.sil.sil_run import LOG_NAME
from hil.sil.timing_document import read_timing
from hil.sil.tip_errors import prediction_error, true_tip_m
from models.plant.plant import NOMINAL, read_plant
from models.shared.kinematics import rigid_tip_m
from models.trials.files import read_trial
from tests.fmu.toy import pendulum
from tests.hil.faults.toy_robot import manifest

BASE_M, LENGTH_M = 0.06, 0.95


class RigidPredictor:
    """Where a link that does not bend would be."""

    def __init__(self) -> None:
        self._prediction = Prediction(np.zeros(3), np.ones(1), np.full(3, 0.01))

    def predict(self, angle_rad, current_a, di, *_) -> Prediction:
        self._prediction.tip_m[:] = rigid_tip_m(np.atleast_2d(angle_rad), BASE_M, LENGTH_M)[0]
        return self._prediction


@pytest.fixture(scope="session")
def bundles(tmp_path_factory):
    def bundle(dof: int) -> ModelBundle:
        directory = tmp_path_factory.mktemp(f"bundle_{dof}dof")
        write_manifest(directory, manifest(dof))
        return ModelBundle(directory, manifest(dof), NoEstimator(), RigidPredictor())

    return {dof: bundle(dof) for dof in (1, 2)}


@pytest.fixture
def options(twins, bundles, tmp_path):
    def build(dof: int = 1, **changes) -> SilOptions:
        defaults = {
            "bundle": bundles[dof], "out": tmp_path, "fmu": twins[dof], "model": MODELS[54024],
            "line": "virtual", "seconds": 3.0,
        }  # fmt: skip
        return SilOptions(**(defaults | changes))

    return build


def test_the_servo_follows_and_the_tip_sags_below_the_rigid_one(options):
    result = run_sil(options(seconds=9.0, payload_kg=2.0))
    records = result.records
    assert result.summary.ended is Ended.FINISHED
    assert np.all(np.diff(records["tick"]) == 1) and not records["missed"].any()
    # The goal of a tick is what the servo heads for until the next: it lags by 1 / 12 s⁻¹ or so.
    lag = records["goal_1_rad"] - records["angle_1_rad"]
    assert np.max(np.abs(lag)) < 0.76 * 0.2
    assert np.max(np.abs(records["angle_1_rad"])) == pytest.approx(math.radians(30), abs=0.03)
    truth = true_tip_m(records, result.outcome.truth)
    assert np.isfinite(truth).all()
    lean = np.argmax(records["angle_1_rad"])
    assert truth[lean, 0] > records["predicted_tip_x_m"][lean] + 5e-3, "gravity bends it outwards"
    assert truth[lean, 2] < records["predicted_tip_z_m"][lean]


def test_what_the_robot_measures_is_the_plant_within_its_resolution(options):
    """The line adds delay and resolution, nothing else: step the plant itself beside it."""
    result = run_sil(options(seconds=2.0, latency_s=0.0, payload_kg=1.0))
    servo, plant = MODELS[54024], read_plant(NOMINAL).step_model(1, "twin")
    p = plant.parameter_values()
    u = np.array([0.0, 1.0])
    x = np.asarray(plant.initial(u, p)).ravel()
    now_ns = 0
    for record in result.records:
        # 15 bytes ask, after the return delay 18 answer, 19 bring the goal, at 10 µs each.
        sample_ns = int(record["deadline_ns"]) + 150_000
        x = plant.advance(x, u, p, (sample_ns - now_ns) * 1e-9)
        angle_rad, current_a, *_ = np.asarray(plant.output(x, u, p)).ravel()
        assert abs(angle_rad - record["angle_1_rad"]) <= servo.rad_per_pulse
        assert abs(current_a - record["current_1_a"]) <= servo.current_a_per_lsb
        now_ns = sample_ns + 500_000 + 180_000 + 190_000
        x = plant.advance(x, u, p, (now_ns - sample_ns) * 1e-9)
        u[0] = servo.angle_rad(servo.position_raw(float(record["goal_1_rad"])))


@pytest.mark.parametrize(
    ("faults", "ended"),
    [
        ({"lost": 0.05, "corrupt": 0.05, "noise": 0.05}, Ended.FINISHED),
        ({"lost": 0.7}, Ended.TRIPPED),
    ],
)
def test_faults_of_the_line_are_survived_or_stop_the_robot(options, faults, ended):
    result = run_sil(options(faults=faults, seed=4))
    records = result.records
    assert result.summary.ended is ended
    again = records["bus_status"] == BusStatus.RETRIED
    assert again.any()
    assert (ended is Ended.TRIPPED) == (records["stale_ticks"].max() >= 3)
    # The longest tick with a lost reply; in simulated time all of it is the line's.
    assert (records["lateness_ns"] + records["busy_ns"])[again].max() <= 11_000_000
    assert not records["missed"].any()
    # Stale data is repeated, never zero and never garbage.
    steps = np.abs(np.diff(records["angle_1_rad"]))
    assert steps.max() < 0.76 * 0.017 * (records["stale_ticks"].max() + 2)


@pytest.mark.slow
def test_a_run_leaves_log_trial_and_verdict(options):
    chosen = options(2, motion=MotionConfig(phase_2_rad=math.pi / 2), faults={"lost": 0.1})
    result = run_sil(chosen)
    result.write()
    timing = result.timing
    assert read_timing(chosen.out / "timing.json") == timing
    assert '"verdict": "pass"' in (chosen.out / "timing.json").read_text(), ".ci/run reads it"
    assert ET.parse(chosen.out / "timing.xml").getroot().tag == "testsuite"
    assert b"<svg" in (chosen.out / "summary.svg").read_bytes()
    log = read_recording(chosen.out / LOG_NAME)
    assert log.complete
    np.testing.assert_array_equal(log.columns["angle_2_rad"], result.records["angle_2_rad"])
    trial = read_trial(chosen.out / "trial" / "sil.csv")
    fresh = result.records["stale_ticks"] == 0
    motion = result.records[fresh & (result.records["tick"] >= 0)]
    np.testing.assert_array_equal(trial.angle_rad[motion["tick"], 0], motion["angle_1_rad"])
    assert trial.meta.phase_2_rad == pytest.approx(math.pi / 2)
    assert np.isnan(trial.markers_m).all()
    assert "interpolated" in trial.meta.notes
    assert timing.prediction_error.n == fresh.sum()
    assert timing.reason in describe_sil(timing, chosen.out)


@pytest.mark.slow
@pytest.mark.parametrize("line", ["socket", "pty"])
def test_the_verdict_on_a_run_in_real_time_follows_from_its_evidence(options, line):
    chosen = options(line=line, seconds=1.0)
    result = run_sil(chosen)
    timing, records = result.timing, result.records
    assert result.summary.faults <= {Fault.DATA, Fault.SLOTS}, "a host can hold these up, no more"
    # Slots are lost where a tick ended after its slot, and nowhere else.
    late = records["lateness_ns"] + records["busy_ns"] > 17_000_000
    assert [miss.tick for miss in timing.missed] == records["tick"][late].tolist()
    assert timing.slots - timing.ticks == timing.misses == sum(timing.causes.values())
    assert timing.own_misses == timing.misses - timing.causes[Cause.PREEMPTED]
    assert (timing.verdict == "fail") == (timing.own_misses > 0)
    assert timing.environment.line == line
    assert timing.reference_jitter.n > 0
    assert len(result.outcome.releases.due_ns) >= len(records) - 10
    known = np.isfinite(true_tip_m(records, result.outcome.truth)[:, 0])
    np.testing.assert_array_equal(known, records["stale_ticks"] == 0)
    assert result.summary.telemetry_drops == 0
    assert len(read_recording(chosen.out / LOG_NAME).columns["tick"]) == len(records)


class SlowOnce(RigidPredictor):
    """Computes for 45 ms, by the processor's clock, in its 20th tick."""

    ticks = 0

    def predict(self, angle_rad, current_a, di, *_) -> Prediction:
        self.ticks += 1
        end_s = time.thread_time() + 45e-3
        while self.ticks == 20 and time.thread_time() < end_s:
            pass
        return super().predict(angle_rad, current_a, di)


@pytest.mark.slow
def test_a_run_in_real_time_fails_where_the_loop_computes_longer_than_its_period(options):
    chosen = options(line="socket", seconds=1.0)
    slow = replace(chosen, bundle=replace(chosen.bundle, predictor=SlowOnce()))
    result = run_sil(slow)
    timing = result.timing
    assert (timing.verdict, timing.verdict.exit_code) == ("fail", 1)
    [miss] = [miss for miss in timing.missed if miss.tick == result.records["tick"][19]]
    assert miss.cause is Cause.OWN_COMPUTE
    assert miss.excess_ns >= 28_000_000, "45 ms in a period of 17 ms"
    assert miss.slots >= 2 and timing.own_misses >= miss.slots


class Interrupter(RigidPredictor):
    """Sends this process SIGTERM in one tick, as `timeout` does."""

    def __init__(self, tick: int) -> None:
        super().__init__()
        self.remaining = tick

    def predict(self, angle_rad, current_a, di, *_) -> Prediction:
        self.remaining -= 1
        if self.remaining == 0:
            signal.raise_signal(signal.SIGTERM)
        return super().predict(angle_rad, current_a, di)


@pytest.mark.slow
@pytest.mark.parametrize(("tick", "at_rest"), [(30, True), (120, False)])
def test_a_run_that_a_signal_ended_early_is_inconclusive_and_leaves_its_trial(
    options, tick, at_rest
):
    chosen = options(seconds=9.0)
    cut = replace(chosen, bundle=replace(chosen.bundle, predictor=Interrupter(tick)))
    result = run_sil(cut)
    result.write()
    timing, last = result.timing, result.records["tick"][tick - 2]
    assert (timing.run.ended, timing.verdict.exit_code) == ("signalled", 3)
    assert 0 < last < tick - 1, "some ticks led to the first goal"
    assert timing.reason.startswith(f"SIGTERM ended the run after {last + 1} of 529 slots")
    trial = read_trial(chosen.out / "trial" / "sil.csv")
    assert trial.meta.rest_samples == (len(trial) - 1 if at_rest else 59)


def test_prediction_error_takes_fresh_ticks_only():
    records = np.zeros(4, tick_dtype(1))
    records["deadline_ns"], records["busy_ns"] = np.arange(4) * 100, 50
    records["stale_ticks"] = (0, 0, 1, 0)
    records["predicted_tip_x_m"] = 1.0
    records["half_width_x_m"] = 0.15
    truth = Truth(
        np.array([10, 110, 210]), np.array([[1.1, 0.0, 0.0], [1.2, 0.0, 0.0], [9.0, 0.0, 0.0]])
    )
    error = prediction_error(records, truth)
    assert error.n == 2, "tick 2 is stale, tick 3 got no answer"
    assert error.mean_euclidean_distance_m == pytest.approx(0.15)
    assert error.max_m == pytest.approx(0.2)
    assert error.interval_coverage == pytest.approx(3 / 4), "y of one joint cannot miss"
    assert error.interval_coverage_least == pytest.approx(1 / 2)
    assert prediction_error(records[3:], truth).rms_m is None


def test_the_prediction_error_is_split_by_range_and_part_of_the_programme():
    records = np.zeros(7, tick_dtype(1))
    records["time_s"] = [-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    records["deadline_ns"], records["busy_ns"] = np.arange(7) * 100, 50
    records["in_range"] = (1, 1, 1, 1, 0, 1, 1)
    records["state"][6] = SafetyState.STOPPING
    true_m = np.zeros((7, 3))
    true_m[:, 1] = [0.7, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    truth = Truth(np.arange(7) * 100 + 10, true_m)
    parts = prediction_error(records, truth, {"rest": 1.0, "motion": 2.0, "glide": 1.0}).parts
    expected = {"in_range": 0.4, "out_of_range": 0.4, "approach": 0.7, "rest": 0.3, "motion": 0.25,
                "glide": 0.4, "stop": 0.6}  # fmt: skip
    assert {k: v.mean_euclidean_distance_m for k, v in parts.items()} == pytest.approx(expected)


def test_a_run_leaves_the_log_of_another_in_progress_alone(options, tmp_path):
    log = tmp_path / LOG_NAME
    log.write_bytes(b"of the run in progress")
    with locked_directory(tmp_path), pytest.raises(InputError, match="in use by another run"):
        run_sil(options())
    assert log.read_bytes() == b"of the run in progress"


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"seconds": 0.0}, "--seconds"),
        ({"seconds": 1e12}, "--seconds"),
        ({"baud": 9600}, "ms of transmission"),
        ({"load": -1}, "--load"),
        ({"runs": 2}, "--runs"),
        ({"miss_rate": 0.0}, "--miss-rate"),
        ({"rig": RigSource()}, "--rig: replaces a twin"),
        ({"payload_kg": math.nan}, "--payload-kg"),
        ({"latency_s": -1e-3}, "--latency-ms"),
        ({"latency_s": 16e-3}, "answers take .* ms, bus.reply_timeout_s allows 8 ms"),
        ({"out": NOMINAL}, "--out"),
        ({"fmu": None}, "plant.json"),
        ({"motion": MotionConfig(amplitude_rad=1.2)}, "motion"),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_sentence(options, changes, complaint):
    with pytest.raises(InputError, match=complaint):
        run_sil(replace(options(), **changes))


def test_an_fmu_of_other_joints_or_no_twin_is_refused(options, twins, tmp_path):
    with pytest.raises(InputError, match="2 joints, 1 are needed"):
        run_sil(replace(options(), fmu=twins[2]))
    pendulum_fmu = build_fmu(pendulum(), tmp_path / "pendulum.fmu", derivatives=False)
    with pytest.raises(InputError, match="--unit twin"):
        run_sil(replace(options(), fmu=pendulum_fmu))


def test_without_an_fmu_the_bundles_plant_is_built(options, bundles):
    plant = bundles[1].directory / "plant.json"
    plant.write_text(json.dumps(tomllib.loads(NOMINAL.read_text())))
    try:
        built = run_sil(replace(options(), fmu=None))
    finally:
        plant.unlink()
    assert built.records.tobytes() == run_sil(options()).records.tobytes()


@pytest.mark.parametrize(
    ("line", "miss_rate", "seconds"),
    [("virtual", 1e-3, 10.0), ("socket", 1e-3, 2996 * 0.017), ("socket", 1.0, 10.0)],
)
def test_what_is_not_set_follows_from_the_link_and_the_miss_rate(
    bundles, tmp_path, line, miss_rate, seconds
):
    options = SilOptions(bundle=bundles[1], out=tmp_path, line=line, miss_rate=miss_rate)
    assert (options.model.name, options.payload_kg) == (STUDY_LINK.servo.model, 1.0)
    assert options.seconds == pytest.approx(seconds)


class RateEstimator(NoEstimator):
    """Estimates the rate of the joint instead of DI, from two samples and the time between them."""

    waits_for_fresh = True

    def __init__(self):
        self.reset()

    def reset(self):
        self._before_rad = math.nan

    def update(self, angle_rad, current_a, step_s):
        angle, before = float(angle_rad[0]), self._before_rad
        self._before_rad = angle
        return Estimate((angle - before) / step_s, math.nan)


def test_the_estimator_gets_the_samples_of_a_second_read_with_their_time(options, bundles):
    bundle = replace(bundles[1], estimator=RateEstimator())
    result = run_sil(
        options(bundle=bundle, model=MODELS[54025], seconds=4.0, faults={"lost": 0.05}, seed=1)
    )
    records = result.records
    again = records["bus_status"] == BusStatus.RETRIED
    assert again.sum() > 5
    assert np.all(records["sample_late_ns"][again] > 0)
    assert np.all(records["sample_late_ns"][~again] == 0)
    # Within the motion the rate changes by 0.02 rad/s a tick, by 0.04 where goals are late.
    moving = (records["tick"] >= 85) & (records["tick"] < 230)
    assert np.abs(np.diff(records["di"][moving])).max() < 0.05
    log = read_recording(options().out / LOG_NAME)
    assert max(compare(log, bundle).values()) < 1e-12, "a replay takes the times of the log"
    del log.columns["sample_late_ns"]
    assert compare(log, bundle)["di"] > 0.05
