"""Twin, observer and predictor of the link: the numbers, from outside through FMPy."""

import functools
import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S, feature_names
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.predictor import OnnxPredictor
from fmu.fmpy_instance import FmuArchive
from fmu.fmpy_run import inputs_from_motion
from fmu.fmu_checker import varying_steps_s
from fmu.fmu_models import embedded_parts, read_parts
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

MEASURED = [("angle", "rad"), ("current", "a")]
OBSERVED = [("bend", "rad"), ("bend_rate", "rad_s"), ("joint_rate", "rad_s"), ("innovation", "a")]


@pytest.fixture(scope="module")
def fmu_of(tmp_path_factory):
    """The FMU of a kind and bundle, built once; FMI 2.0 for 1DOF, FMI 3.0 for 2DOF."""
    folder = tmp_path_factory.mktemp("fmus")

    @functools.cache
    def build(kind, bundle):
        dof = read_manifest(bundle).dof
        path = folder / f"{kind}_{dof}dof.fmu"
        options = ["--unit", kind, "--fmi", str(dof + 1), "--out", str(path)]
        assert main(["fmu", "build", str(bundle), *options]) == 0
        return path

    return build


@pytest.fixture(scope="module", params=["twin", "observer", "predictor"])
def built(request, bundle, fmu_of):
    """The FMU of each kind and dof, and its parts."""
    kind, dof = request.param, read_manifest(bundle).dof
    return fmu_of(kind, bundle), read_parts(kind, dof, bundle)


@pytest.mark.slow
def test_the_command_passes_each_fmu(built, capsys):
    path, parts = built
    assert main(["fmu", "check", str(path), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["passed"]
    assert set(report["parity"]) == set(names(parts.model().outputs))
    assert max(report["parity"].values()) <= 1e-9


def test_variables_have_the_public_names_and_causalities(built):
    """Names and causalities of docs/co-simulation.md, written out here."""
    path, parts = built
    joints = range(1, parts.dof + 1)
    measured = {f"{name}_{j}_{unit}" for j in joints for name, unit in MEASURED}
    tip = {"tip_x_m", "tip_y_m", "tip_z_m"}
    observed = {f"{name}_{j}_{unit}" for j in joints for name, unit in OBSERVED}
    observed |= {"tip_x_deviation_m", "tip_y_deviation_m", "tip_z_deviation_m"}
    predicted = {f"{name}_{axis}_m" for name in ("predicted_tip", "half_width") for axis in "xyz"}
    predicted.add("in_range")
    inputs, outputs = {
        "twin": ({f"goal_{j}_rad" for j in joints} | {"payload_kg"}, measured | {"di"} | tip),
        "observer": (measured, {"di", "payload_kg"} | tip | observed),
        "predictor": (measured | {"di"}, set()),
    }[parts.kind]
    with FmuArchive(path) as archive:
        variables = archive.description.modelVariables
    found = {c: {v.name for v in variables if v.causality == c} for c in ("input", "output")}
    assert found == {"input": inputs, "output": outputs | predicted}
    parameters = {v.name for v in variables if v.causality == "parameter"}
    expected = set() if parts.plant is None else set(names(parts.model().parameters))
    assert parameters == {"example.scale", *(f"parameters.{name}" for name in expected)}
    units = {v.name: v.unit for v in variables}
    for name, unit in {"tip_z_m": "m", "di": "1", "payload_kg": "kg", "current_1_a": "A"}.items():
        assert units.get(name, unit) == unit


@pytest.mark.parametrize(
    "card",
    ["[" * 100_000, '{"kind": [], "dof": 1}', '{"kind": "twin", "dof": 1000000000}'],
    ids=["deep", "list", "many joints"],
)
def test_the_card_of_a_foreign_fmu_is_ignored(tmp_path, card):
    (tmp_path / "fmu.json").write_text(card)
    assert embedded_parts(tmp_path) is None


def test_the_prediction_of_the_fmu_is_that_of_onnxruntime(bundle, fmu_of):
    """The twin's own outputs put into the ONNX file by onnxruntime, in and out of range."""
    dof = read_manifest(bundle).dof
    parts = read_parts("twin", dof, bundle)
    path = fmu_of("twin", bundle)
    u = inputs_from_motion(parts, parts.model(), Motion("multisine", dof=dof), 1.7, rows=250)
    predictor = OnnxPredictor(bundle / "predictor.onnx", dof)
    outputs = [
        *feature_names(dof), "predicted_tip_x_m", "predicted_tip_y_m", "predicted_tip_z_m",
        "half_width_x_m", "half_width_y_m", "half_width_z_m", "in_range",
    ]  # fmt: skip
    with FmuArchive(path) as archive, archive.instance() as instance:
        y = instance.run(names(parts.model().inputs), u, varying_steps_s(250), outputs)
    for row in y:
        angle_rad, current_a, di = row[:dof], row[dof : 2 * dof], row[2 * dof]
        answer = predictor.predict(angle_rad, current_a, di)
        expected = [*answer.tip_m, *answer.half_width_m, answer.in_range]
        np.testing.assert_allclose(row[2 * dof + 1 :], expected, atol=1e-9, rtol=0)
    assert set(y[:, -1]) == {0.0, 1.0}


def test_the_observer_follows_the_twin_of_its_plant(bundle, fmu_of):
    """From the twin's angle and current it estimates the twin's tip."""
    dof = read_manifest(bundle).dof
    twin = read_parts("twin", dof, bundle)
    plant = CompiledModel(twin.plant.step_model(dof, "twin"))
    payload_kg = 1.0
    u = inputs_from_motion(twin, plant.model, Motion(dof=dof), payload_kg)
    y = plant.simulate(u, PERIOD_S)[1:]
    columns = dict(zip(names(plant.model.outputs), y.T, strict=True))
    path = fmu_of("observer", bundle)
    tip = ["tip_x_m", "tip_y_m", "tip_z_m"]
    model = read_parts("observer", dof, bundle).model()
    with FmuArchive(path) as archive, archive.instance() as instance:
        instance.set({"parameters.payload_known_kg": payload_kg})
        sensed = np.column_stack([columns[name] for name in names(model.inputs)])
        estimated = instance.run(names(model.inputs), sensed, np.full(len(sensed), PERIOD_S), tip)[
            1:
        ]
    actual = np.column_stack([columns[name] for name in tip])
    distance_m = np.linalg.norm(estimated - actual, axis=1)[len(u) // 4 :]
    deflection_m = np.ptp(actual, axis=0).max()
    assert np.sqrt(np.mean(distance_m**2)) < 0.01 * deflection_m


@pytest.mark.slow
def test_check_notices_another_plant(bundle_1dof, fmu_of, tmp_path, capsys):
    plant = read_parts("twin", 1, bundle_1dof).plant
    mass_kg = plant.parameters["link_mass_kg"].value
    plant.with_values({"link_mass_kg": 1.001 * mass_kg}).write(tmp_path / "other.json")
    path = fmu_of("twin", bundle_1dof)
    assert main(["fmu", "check", str(path)]) == 0
    assert main(["fmu", "check", str(path), "--plant", str(tmp_path / "other.json")]) == 1
    assert "NOT sound" in capsys.readouterr().out
