"""FMUs and bundles, built once per session."""

import math

import numpy as np
import onnx
import pytest
from sklearn.model_selection import KFold

from firmware_py.core.signals import PERIOD_S, feature_names, tip_names, unit_of
from firmware_py.inference.golden import Golden, write_golden
from firmware_py.inference.manifest import Manifest, Quantity, write_manifest
from fmu.fmpy_instance import FmuArchive
from fmu.fmu_builder import build_fmu
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names
from models.predictor.onnx_graphs import to_onnx
from models.predictor.polynomials import GuardedPredictor
from tests.fmu.toy import pendulum

GOAL_AMPLITUDE_RAD = math.radians(30.0)
TORQUE_NM = 2.0
"""Amplitude of the toy's example motion."""


@pytest.fixture(scope="session")
def toy():
    return pendulum()


@pytest.fixture(scope="session", params=[2, 3], ids=["fmi2", "fmi3"])
def toy_fmu(request, toy, tmp_path_factory):
    path = tmp_path_factory.mktemp("toy") / f"pendulum_fmi{request.param}.fmu"
    return build_fmu(
        toy, path, fmi=request.param, description="A pendulum & <a counter>.",
        example=(TORQUE_NM, 0.0),
    )  # fmt: skip


@pytest.fixture(scope="module")
def archive(toy_fmu):
    with FmuArchive(toy_fmu) as archive:
        yield archive


@pytest.fixture
def instance(archive):
    with archive.instance() as instance:
        yield instance


@pytest.fixture
def moving(archive):
    """An instance for Co-Simulation in motion, within the saturation."""
    with archive.instance() as instance:
        instance.initialize({"torque_nm": 2.5})
        for _ in range(20):
            instance.step(PERIOD_S)
        instance.set({"torque_nm": 1.5})
        yield instance


@pytest.fixture(scope="session")
def toy_fmu_3(toy, tmp_path_factory):
    return build_fmu(toy, tmp_path_factory.mktemp("toy") / "pendulum.fmu", fmi=3)


def _goals(model, dof, count):
    """Inputs of a twin: a sinusoid, joint 2 a quarter behind, payload 1 kg."""
    time_s = PERIOD_S * np.arange(count)
    columns = {
        f"goal_{j}_rad": GOAL_AMPLITUDE_RAD * np.sin(2 * np.pi * time_s / 4.352 - (j - 1) * 1.57)
        for j in range(1, dof + 1)
    }
    columns["payload_kg"] = np.full(count, 1.0)
    return np.column_stack([columns[name] for name in names(model.inputs)])


def write_bundle(directory, dof):
    """A bundle on the nominal plant: predictor and golden ticks from a run of its own twin."""
    plant = read_plant()
    plant.write(directory / "plant.json")
    twin = plant.step_model(dof, "twin")
    run = CompiledModel(twin).simulate(_goals(twin, dof, 200), PERIOD_S)
    columns = dict(zip(names(twin.outputs), run.T, strict=True))
    features = np.column_stack([columns[name] for name in feature_names(dof)])
    tip_m = np.column_stack([columns[name] for name in tip_names()])
    predictor = GuardedPredictor.fit(3, features, tip_m, KFold(3).split(features))
    onnx.save(to_onnx(predictor.write_graph, features.shape[1]), directory / "predictor.onnx")
    count = len(features)
    golden = Golden(
        features[:, :dof], features[:, dof:-1], PERIOD_S,
        np.zeros(count), np.zeros((count, 3)), np.zeros(count),
    )  # fmt: skip
    write_golden(directory / "golden.npz", golden)
    quantities = tuple(
        Quantity(name, unit_of(name) or "1", float(low), float(high))
        for name, low, high in zip(
            feature_names(dof), features.min(axis=0), features.max(axis=0), strict=True
        )
    )
    write_manifest(
        directory,
        Manifest(
            dof=dof, period_s=PERIOD_S, degree=3, estimator="none", features=quantities,
            outputs=(), lag_ticks=(), training_data_sha256="", plant_sha256="", libraries={},
            metrics={}, files={},
        ),
    )  # fmt: skip
    return directory


@pytest.fixture(scope="session", params=[1, 2], ids=["1dof", "2dof"])
def bundle(request, tmp_path_factory):
    return write_bundle(tmp_path_factory.mktemp(f"bundle_{request.param}dof"), request.param)


@pytest.fixture(scope="session")
def bundle_1dof(tmp_path_factory):
    return write_bundle(tmp_path_factory.mktemp("bundle"), 1)
