"""The robot's loop against the rig: reproducible, the rig's own states, and hidden effects."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_py.bus.servo_models import MODELS
from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.estimator import NoEstimator
from firmware_py.summary import Ended
from hil.emulator.physics import RigSource
from hil.emulator.rig_physics import RigPhysics
from hil.sil import SilOptions, run_sil
from hil.sil.timing_document import read_timing
from hil.sil.tip_errors import true_tip_m
from tests.hil.faults.toy_robot import StillPredictor

STEP_S = 1e-3


@pytest.fixture
def options(bare_bundle, tmp_path):
    bundle = ModelBundle(bare_bundle, read_manifest(bare_bundle), NoEstimator(), StillPredictor())
    return SilOptions(
        bundle=bundle, model=MODELS[54024], out=tmp_path, line="virtual", seconds=2.0,
        rig=RigSource(),
    )  # fmt: skip


@pytest.mark.slow
def test_a_run_is_reproducible_and_its_seed_is_its_variation(options):
    first, second = run_sil(options), run_sil(options)
    assert first.summary.ended is Ended.FINISHED
    assert first.environment.records_sha256 == second.environment.records_sha256
    other = run_sil(replace(options, rig=RigSource(seed=1)))
    assert other.environment.records_sha256 != first.environment.records_sha256


def test_the_robot_measures_the_rig_and_its_tip_belongs_to_the_same_moment(options):
    """Loop, bus and line add delay and resolution only: step a rig beside them."""
    result = run_sil(replace(options, latency_s=0.0))
    servo, beside = MODELS[54024], RigPhysics(RigSource(), 1, options.payload_kg)
    truth = true_tip_m(result.records, result.outcome.truth)
    goal_rad, now_ns = 0.0, 0
    for record, tip_m in zip(result.records, truth, strict=True):
        sample_ns = int(record["deadline_ns"]) + 150_000  # 15 bytes ask
        beside.advance([goal_rad], (sample_ns - now_ns) * 1e-9)
        assert abs(beside.angle_rad[0] - record["angle_1_rad"]) <= servo.rad_per_pulse
        np.testing.assert_allclose(beside.tip_m, tip_m, atol=1e-6)
        now_ns = sample_ns + 860_000  # return delay, 17 bytes of answer, 19 bring the goal
        beside.advance([goal_rad], (now_ns - sample_ns) * 1e-9)
        goal_rad = servo.angle_rad(servo.position_raw(float(record["goal_1_rad"])))


def test_what_is_hidden_moves_the_true_tip_and_nothing_else_at_rest():
    plain, bent = (RigPhysics(RigSource(hidden), 1) for hidden in ({}, {"prebend": 0.05}))
    for physics in (plain, bent):
        physics.advance([0.0], 1.0)
    # Bent evenly, a link leans by half of the bend; its relaxing branches hold some of it back.
    assert bent.tip_m[0] - plain.tip_m[0] == pytest.approx(0.5 * 0.05 * 0.95, rel=0.15)
    assert abs(bent.angle_rad[0] - plain.angle_rad[0]) < 1e-3


def test_time_that_is_too_short_for_a_step_is_not_lost():
    apart, together = RigPhysics(RigSource(), 1), RigPhysics(RigSource(), 1)
    for _ in range(40):
        apart.advance([0.3], 0.25 * STEP_S)
    together.advance([0.3], 10 * STEP_S)
    assert apart.angle_rad[0] == together.angle_rad[0] != 0.0


@pytest.mark.slow
def test_a_run_becomes_a_trial_and_says_what_stood_behind_the_servos(options):
    options = replace(options, rig=RigSource({"prebend": 0.01}))
    result = run_sil(options)
    result.write()
    timing = result.timing
    assert timing.environment.behind_the_servos == "rig"
    assert timing.environment.hidden == {"prebend": 0.01}
    assert (options.out / "trial" / "sil.csv").is_file()
    assert read_timing(options.out / "timing.json").prediction_error.n > 0


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"line": "socket"}, "--line virtual"),
        ({"fmu": "twin.fmu"}, "replaces a twin"),
        ({"rig": RigSource({"stiffness_softening": 2.0})}, "--hide stiffness_softening"),
        ({"rig": RigSource({"stiffness_softening": 0.85}), "payload_kg": 9.0}, "folds"),
    ],
)
def test_what_cannot_be_run_is_refused(options, changes, complaint):
    with pytest.raises(InputError, match=complaint):
        run_sil(replace(options, **changes))
