"""A probing motion in software: before slot 0, its finding told to the observer, and replayed."""

import hashlib

import msgspec
import numpy as np
import pytest

from firmware_py.bus.servo_models import MODELS
from firmware_py.commands.replay import compare
from firmware_py.core.signals import PERIOD_S
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.estimator import Estimate, ObserverEstimator
from firmware_py.inference.manifest import MANIFEST
from firmware_py.log.recording import read_recording
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from hil.emulator.physics import build_twin
from hil.sil import SilOptions, run_sil, write_results
from hil.sil.sil_loop import LOG_NAME
from models.plan.learning import read_plan_run
from models.plan.paths import PathOptions, built_in_path
from models.plan.planning import PlanRequest, plan_path
from models.plant.plant import NOMINAL, read_plant
from tests.hil.sil.test_sil import RigidPredictor

PAYLOAD_KG = 0.8


class UnbentPredictor(RigidPredictor):
    """Knows no bend, and takes the innovation of the current."""

    wanted = ("innovation_1_a",)


class Slow(ObserverEstimator):
    """Estimate that falls from sample to sample, unless the payload is assumed."""

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
        own = 1.5 - 1e-3 * self._samples
        return Estimate(0.0, own if self._payload_kg is None else self._payload_kg, np.zeros(1))


@pytest.fixture
def bundle(bare_bundle):
    manifest = msgspec.structs.replace(read_manifest(bare_bundle), estimator="observer")
    sha256 = hashlib.sha256((bare_bundle / MANIFEST).read_bytes()).hexdigest()
    return ModelBundle(bare_bundle, manifest, Slow(), UnbentPredictor(), sha256)


@pytest.fixture(scope="module")
def plan(bare_bundle):
    path = built_in_path("line", 1, PERIOD_S, PathOptions(size_m=0.1, seconds=2.0))
    sha256 = hashlib.sha256((bare_bundle / MANIFEST).read_bytes()).hexdigest()
    request = PlanRequest(read_plant(), 1, PERIOD_S, Limits(), (0.5, 1.5), sha256, probe=True)
    return plan_path(path, request)


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return build_twin(NOMINAL, 1, tmp_path_factory.mktemp("twin"))


@pytest.fixture
def options(bundle, plan, fmu, tmp_path):
    def build(**changes):
        given = {
            "bundle": bundle, "model": MODELS[54025], "out": tmp_path, "fmu": fmu,
            "line": "virtual", "seconds": plan.duration_s, "payload_kg": PAYLOAD_KG, "plan": plan,
        }  # fmt: skip
        return SilOptions(**(given | changes))

    return build


def test_the_probe_precedes_the_plan_and_tells_the_payload(options, bundle, plan, tmp_path):
    chosen = options()
    result = run_sil(chosen)
    assert result.summary.reason == "the motion is over"
    records = result.records
    probing = records[(records["tick"] >= -plan.probe.rows) & (records["tick"] < 0)]
    assert probing["goal_1_rad"] == pytest.approx(plan.probe.goals_rad[0], abs=1e-9)
    assert np.all(records["goal_1_rad"][records["tick"] < -plan.probe.rows] == 0.0)
    assert bundle.estimator.assumed[0] is None
    assert bundle.estimator.assumed[1] == pytest.approx(PAYLOAD_KG, abs=0.1)
    assert records["payload_kg"][-1] == bundle.estimator.assumed[1]
    errors = write_results(result, chosen).path_errors
    assert [e.rows for e in errors] == [plan.rows], "its rows are not those of the path"
    log = read_recording(tmp_path / LOG_NAME)
    assert max(compare(log, bundle).values()) < 1e-12
    assert read_plan_run(tmp_path / LOG_NAME, plan).source == "observer"


def test_a_robot_without_feedback_does_not_probe(options, bundle, plan, tmp_path):
    result = run_sil(options(open_loop=True, payload_known=True))
    records = result.records
    assert np.all(records["goal_1_rad"][records["tick"] < 0] == 0.0)
    assert bundle.estimator.assumed == [PAYLOAD_KG]
    assert max(compare(read_recording(tmp_path / LOG_NAME), bundle).values()) < 1e-12


def test_stale_data_while_probing_has_the_observer_estimate_afresh(options, bundle, tmp_path):
    result = run_sil(options(faults={"lost": 0.15}, seed=1))
    assert result.summary.reason == "the motion is over"
    assert SafetyState.DEGRADED in result.records["state"][result.records["tick"] < 0]
    assert bundle.estimator.assumed == [None, None]
    assert max(compare(read_recording(tmp_path / LOG_NAME), bundle).values()) < 1e-12
