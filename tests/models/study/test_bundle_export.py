"""The graphs against scikit-learn and against each other; the bundle on disk."""

import json
import shutil

import casadi as ca
import numpy as np
import onnx
import onnxruntime as ort
import pytest

from firmware_py.errors import InputError
from firmware_py.inference.bundle import read_manifest
from models.learning.onnx_power import PolynomialGraph, to_onnx
from models.learning.onnx_symbolic import predictor_function
from models.learning.predictors import GuardedPredictor, polynomial_pipeline, predict
from models.plant.plant import read_plant
from models.study.bundle_export import GATE_M, ParityError, check_parity, monomial, write_bundle
from models.study.study_document import read_study

CASES = [(n, degree) for n in (3, 5) for degree in range(1, 7)]


def fitted(n, degree, seed=0):
    rng = np.random.default_rng(seed)
    size = np.array([0.5, 0.5, 3.0, 3.0, 0.005])[[0, 2, 4] if n == 3 else slice(None)]
    features = rng.uniform(-1, 1, (1500, n)) * size
    targets = np.column_stack([np.sin(0.3 * features @ rng.normal(size=n) + k) for k in range(3)])
    folds = [(np.arange(300, 1500), np.arange(300))]
    return GuardedPredictor.fit(degree, features, targets, folds), features


def answers(path, points):
    session = ort.InferenceSession(path)
    rows = [session.run(None, {"features": point[None]}) for point in points]
    return [np.array([row[k][0] for row in rows]) for k in range(3)]


@pytest.mark.parametrize(("n", "degree"), CASES)
def test_graph_answers_what_scikit_learn_does(n, degree, tmp_path):
    predictor, features = fitted(n, degree)
    path = tmp_path / "predictor.onnx"
    onnx.save(to_onnx(predictor, n), path)
    points = np.vstack([features[:100], 1.5 * features[:100]])  # half of them out of range
    tip_m, in_range, half_width_m = answers(path, points)
    np.testing.assert_allclose(tip_m, predictor.predict(points), rtol=0, atol=1e-11)
    np.testing.assert_allclose(half_width_m, predictor.half_width(points), rtol=1e-9)
    assert in_range[:, 0].astype(bool).tolist() == predictor.in_range(points).tolist()
    assert set(in_range[:, 0]) == {0.0, 1.0}


@pytest.mark.parametrize(("n", "degree"), [(3, 3), (5, 3), (5, 6)])
def test_casadi_imports_the_same_file(n, degree, tmp_path):
    predictor, features = fitted(n, degree)
    path = tmp_path / "predictor.onnx"
    onnx.save(to_onnx(predictor, n), path)
    function = predictor_function(path)
    assert function.name_in() == ["features"]
    assert function.name_out() == ["tip_m", "in_range", "half_width_m"]
    points = np.vstack([features[:30], 1.5 * features[:30], [[np.nan] * n]])
    expected = answers(path, points)
    actual = [function(point) for point in points]
    for k in range(3):
        values = np.array([np.asarray(row[k]).ravel() for row in actual])
        rows = slice(0, -1) if k == 0 else slice(None)  # the tip of a NaN is not specified
        np.testing.assert_allclose(values[rows], expected[k][rows], rtol=0, atol=1e-12)


def test_casadi_differentiates_the_import(tmp_path):
    predictor, features = fitted(3, 4)
    path = tmp_path / "predictor.onnx"
    onnx.save(to_onnx(predictor, 3), path)
    x = ca.MX.sym("x", 3)
    tip = predictor_function(path)(x)[0]
    jacobian = ca.Function("jacobian", [x], [ca.jacobian(tip, x)])
    point, step = 0.5 * features[0], 1e-6 * np.abs(features).max(axis=0)
    for i in range(3):
        shift = np.eye(3)[i] * step
        slope = predictor.predict((point + shift)[None]) - predictor.predict((point - shift)[None])
        expected = slope[0] / (2 * step[i])
        np.testing.assert_allclose(np.array(jacobian(point))[:, i], expected, rtol=1e-5, atol=1e-6)


def test_graph_is_one_that_old_runtimes_load_and_names_what_it_holds():
    predictor, _ = fitted(3, 5)
    graph = to_onnx(predictor, 3, metadata={"features": [{"name": "di", "unit": "1"}], "dof": 1})
    assert (graph.ir_version, [(o.domain, o.version) for o in graph.opset_import]) == (
        7,
        [("", 13)],
    )
    assert len(graph.graph.node) < 25
    facts = {prop.key: json.loads(prop.value) for prop in graph.metadata_props}
    assert facts == {"features": [{"name": "di", "unit": "1"}], "dof": 1}
    assert (
        graph.SerializeToString()
        == to_onnx(
            predictor, 3, metadata={"features": [{"name": "di", "unit": "1"}], "dof": 1}
        ).SerializeToString()
    )


def test_a_nan_is_out_of_range_and_has_no_width(tmp_path):
    predictor, features = fitted(5, 3)
    path = tmp_path / "predictor.onnx"
    onnx.save(to_onnx(predictor, 5), path)
    for column in range(5):
        point = 0.5 * features[:1].copy()
        point[0, column] = np.nan
        _, in_range, half_width_m = answers(path, point)
        assert in_range[0, 0] == 0.0
        assert np.isnan(half_width_m).all()


def test_a_polynomial_alone_is_clipped_only_if_it_is_told_to(tmp_path):
    rng = np.random.default_rng(3)
    features, targets = rng.uniform(-1, 1, (200, 2)), rng.standard_normal((200, 1))
    pipeline = polynomial_pipeline(2).fit(features, targets)
    far = np.array([[4.0, -4.0]])
    box = (features.min(axis=0), features.max(axis=0))
    for bounds, seen in ((None, far), (box, np.clip(far, *box))):
        path = tmp_path / "graph.onnx"
        onnx.save(to_onnx(PolynomialGraph(pipeline, "di", bounds), 2, "lagged"), path)
        answer = ort.InferenceSession(path).run(["di"], {"lagged": far})[0]
        np.testing.assert_allclose(answer, predict(pipeline, seen), atol=1e-12)


def test_gate_refuses_a_graph_that_is_off_by_a_nanometre(tmp_path):
    predictor, features = fitted(3, 3)
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
    assert manifest.plant_sha256 == read_plant(toy_bundle / "plant.json").sha256()
    study = read_study(toy_bundle / "study.json")
    assert study == toy_study.document
    assert manifest.degree == study.chosen_degree
    assert (toy_bundle / "study.json").stat().st_size < 600_000
    facts = onnx.load(toy_bundle / "predictor.onnx").metadata_props
    assert {"features", "outputs", "in_range", "half_width_m"} <= {prop.key for prop in facts}


def test_manifest_coefficients_evaluate_to_the_prediction(toy_bundle, toy_study):
    manifest = read_manifest(toy_bundle)
    names = [q.name for q in manifest.features]
    rows = toy_study.training.features("observer")[::97]
    total = np.zeros((len(rows), 3))
    for text, beta in manifest.coefficients.items():
        value = np.ones(len(rows))
        for factor in text.split():
            name, _, power = factor.partition("^")
            value *= 1.0 if name == "1" else rows[:, names.index(name)] ** int(power or 1)
        total += value[:, None] * np.array(beta)
    np.testing.assert_allclose(total, toy_study.predictor.predict(rows), atol=1e-6)


def test_monomials_read_like_the_papers_equation():
    names = ("angle_1_rad", "current_1_a", "di")
    assert monomial((0, 0, 0), names) == "1"
    assert monomial((2, 0, 1), names) == "angle_1_rad^2 di"


def test_the_same_study_writes_the_same_bytes(toy_bundle, toy_study, tmp_path):
    write_bundle(tmp_path / "again", toy_study, read_plant())
    for file in toy_bundle.iterdir():
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes(), file.name


def test_a_directory_that_is_no_bundle_is_left_alone(toy_study, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="not a bundle"):
        write_bundle(tmp_path, toy_study, read_plant())
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_a_bundle_that_fails_half_way_leaves_the_old_one(
    toy_bundle, toy_study, tmp_path, monkeypatch
):
    old = tmp_path / "bundle"
    shutil.copytree(toy_bundle, old)
    before = {file.name: file.read_bytes() for file in old.iterdir()}
    monkeypatch.setattr("models.study.bundle_export.model_card", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_bundle(old, toy_study, read_plant())
    assert {file.name: file.read_bytes() for file in old.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["bundle"]


def test_a_damaged_graph_is_named(tmp_path):
    (tmp_path / "predictor.onnx").write_bytes(b"not a graph")
    with pytest.raises(InputError, match=r"predictor\.onnx"):
        predictor_function(tmp_path / "predictor.onnx")
