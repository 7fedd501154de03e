"""Robot of two joints over a plant that needs no compiler, for cases on the virtual line."""

from pathlib import Path
from types import SimpleNamespace

from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.estimator import NoEstimator
from firmware_py.inference.manifest import Manifest
from hil.faults.case_robot import CaseRobot
from tests.firmware_py.simulated_loop import StillPredictor
from tests.hil.conftest import LagPlant

PERIOD_S = 0.017


def manifest(dof: int) -> Manifest:
    return Manifest(
        dof=dof, period_s=PERIOD_S, degree=1, estimator="none", features=(), outputs=(),
        lag_ticks=(0,), training_data_sha256="", plant_sha256="", libraries={}, metrics={},
        files={},
    )  # fmt: skip


class ToyPhysics(LagPlant):
    """Stands in for `FmuPhysics`."""

    def __init__(self, fmu, dof):
        super().__init__(dof)
        self.fmu = SimpleNamespace(close=lambda: None)


def toy_robot(directory: Path) -> CaseRobot:
    return CaseRobot(
        ModelBundle(directory, manifest(2), NoEstimator(), StillPredictor()), directory
    )
