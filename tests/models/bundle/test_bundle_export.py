"""Bundle on disk: parity gate, contents, reproducibility."""

import shutil

import numpy as np
import onnx
import pytest

from firmware_py.errors import InputError
from firmware_py.inference.bundle import read_manifest
from models.bundle.files import GATE_M, ParityError, check_parity, monomial, write_bundle
from models.plant.plant import read_plant
from models.predictor.onnx_graphs import to_onnx
from models.study.document import read_study
from tests.models.predictor.cases import fitted_predictor


def test_gate_refuses_a_graph_that_is_off_by_a_nanometre(tmp_path):
    predictor, features = fitted_predictor(3, 3)
    graph = to_onnx(predictor, 3)
    path = tmp_path / "predictor.onnx"
    onnx.save(graph, path)
    assert max(check_parity(path, predictor, features, 1).values()) < GATE_M
    weights = next(i for i in graph.graph.initializer if i.name.startswith("tip_weights"))
    changed = onnx.numpy_helper.to_array(weights) * (1 + 1e-7)
    weights.CopyFrom(onnx.numpy_helper.from_array(changed, weights.name))
    onnx.save(graph, path)
    with pytest.raises(ParityError, match="no bundle written"):
        check_parity(path, predictor, features, 1)


def test_bundle_holds_what_the_contract_lists(toy_bundle, toy_study):
    manifest = read_manifest(toy_bundle)
    assert set(manifest.files) == {
        "predictor.onnx", "lagged.onnx", "plant.json", "study.json", "golden.npz", "MODEL_CARD.md",
    }  # fmt: skip
    assert [q.name for q in manifest.features] == ["angle_1_rad", "current_1_a", "di"]
    assert [(q.name, q.unit) for q in manifest.outputs] == [
        ("tip_x_m", "m"), ("tip_y_m", "m"), ("tip_z_m", "m"),
    ]  # fmt: skip
    plant = read_plant(toy_bundle / "plant.json")
    assert manifest.plant_sha256 == plant.sha256()
    assert not plant.provenance.noise_floor, "the robot needs none"
    study = read_study(toy_bundle / "study.json")
    assert study == toy_study
    assert manifest.degree == study.chosen_degree
    assert (toy_bundle / "study.json").stat().st_size < 600_000
    facts = onnx.load(toy_bundle / "predictor.onnx").metadata_props
    assert {"features", "outputs", "in_range", "half_width_m"} <= {prop.key for prop in facts}


def test_manifest_coefficients_evaluate_to_the_prediction(toy_bundle, toy_fallback):
    manifest = read_manifest(toy_bundle)
    names = [q.name for q in manifest.features]
    rows = toy_fallback.samples.features("observer")[::97]
    total = np.zeros((len(rows), 3))
    for text, beta in manifest.coefficients.items():
        value = np.ones(len(rows))
        for factor in text.split():
            name, _, power = factor.partition("^")
            value *= 1.0 if name == "1" else rows[:, names.index(name)] ** int(power or 1)
        total += value[:, None] * np.array(beta)
    np.testing.assert_allclose(total, toy_fallback.predictor.predict(rows), atol=1e-6)


def test_monomials_read_like_the_papers_equation():
    names = ("angle_1_rad", "current_1_a", "di")
    assert monomial((0, 0, 0), names) == "1"
    assert monomial((2, 0, 1), names) == "angle_1_rad^2 di"


def test_the_same_study_writes_the_same_bytes(toy_bundle, toy_fallback, toy_study, tmp_path):
    write_bundle(tmp_path / "again", read_plant(), toy_fallback, study=toy_study)
    for file in toy_bundle.iterdir():
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes(), file.name


def test_a_directory_that_is_no_bundle_is_left_alone(toy_fallback, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="not a bundle"):
        write_bundle(tmp_path, read_plant(), toy_fallback)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_a_bundle_that_fails_half_way_leaves_the_old_one(
    toy_bundle, toy_fallback, tmp_path, monkeypatch
):
    old = tmp_path / "bundle"
    shutil.copytree(toy_bundle, old)
    before = {file.name: file.read_bytes() for file in old.iterdir()}
    monkeypatch.setattr("models.bundle.files.write_model_card", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_bundle(old, read_plant(), toy_fallback)
    assert {file.name: file.read_bytes() for file in old.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["bundle"]
