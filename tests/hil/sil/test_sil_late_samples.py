"""Samples of a second read in software: the estimator gets them with their true time."""

import math

import numpy as np
import pytest

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.commands.replay import compare
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.estimator import Estimate, NoEstimator
from firmware_py.log.recording import read_recording
from hil.emulator.physics import build_twin
from hil.sil import SilOptions, run_sil
from hil.sil.sil_loop import LOG_NAME
from models.plant.plant import NOMINAL
from tests.hil.sil.test_sil import RigidPredictor

LARGEST_CHANGE_RAD_S = 0.05
"""Of the joint's rate from tick to tick: 0.02 rad/s by the motion, 0.04 where goals are late."""

MOTION = range(85, 230)
"""Ticks between the start of the motion and the stop, where the rate changes faster."""


class RateEstimator(NoEstimator):
    """Tells the rate of the joint in place of DI, from two samples and the time between them."""

    waits_for_fresh = True

    def __init__(self):
        self.reset()

    def reset(self):
        self._before_rad = math.nan

    def update(self, angle_rad, current_a, step_s):
        angle, before = float(angle_rad[0]), self._before_rad
        self._before_rad = angle
        return Estimate((angle - before) / step_s, math.nan)


@pytest.fixture
def bundle(bare_bundle):
    return ModelBundle(bare_bundle, read_manifest(bare_bundle), RateEstimator(), RigidPredictor())


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return build_twin(NOMINAL, 1, tmp_path_factory.mktemp("twin"))


@pytest.mark.parametrize("faults", [{"lost": 0.05}, {"corrupt": 0.05}])
def test_a_repeated_read_is_no_jump_to_the_observer(bundle, fmu, faults, tmp_path):
    result = run_sil(
        SilOptions(
            bundle=bundle, model=MODELS[54025], out=tmp_path, fmu=fmu, line="virtual",
            seconds=4.0, faults=faults, seed=1,
        )
    )  # fmt: skip
    records = result.records
    again = records["bus_status"] == BusStatus.RETRIED
    assert again.sum() > 5
    assert np.all(records["sample_late_ns"][again] > 0)
    assert np.all(records["sample_late_ns"][~again] == 0)
    moving = np.isin(records["tick"], MOTION)
    assert np.abs(np.diff(records["di"][moving])).max() < LARGEST_CHANGE_RAD_S
    log = read_recording(tmp_path / LOG_NAME)
    assert max(compare(log, bundle).values()) < 1e-12, "a replay takes the times of the log"
    del log.columns["sample_late_ns"]  # as a log of before
    assert compare(log, bundle)["di"] > LARGEST_CHANGE_RAD_S
