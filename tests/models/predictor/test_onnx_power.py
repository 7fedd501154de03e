"""ONNX graphs in the power form against scikit-learn."""

import json

import numpy as np
import onnx
import onnxruntime as ort
import pytest

from models.predictor.onnx_graphs import PolynomialGraph, to_onnx
from models.predictor.polynomials import polynomial_pipeline, predict
from tests.models.predictor.graph_cases import fitted_predictor, graph_outputs

CASES = [(n, degree) for n in (3, 5) for degree in range(1, 7)]


@pytest.mark.parametrize(("n", "degree"), CASES)
def test_graph_answers_what_scikit_learn_does(n, degree, tmp_path):
    predictor, features = fitted_predictor(n, degree)
    path = tmp_path / "predictor.onnx"
    onnx.save(to_onnx(predictor, n), path)
    points = np.vstack([features[:100], 1.5 * features[:100]])  # half of them out of range
    tip_m, in_range, half_width_m = graph_outputs(path, points)
    np.testing.assert_allclose(tip_m, predictor.predict(points), rtol=0, atol=1e-11)
    np.testing.assert_allclose(half_width_m, predictor.half_width(points), rtol=1e-9)
    assert in_range[:, 0].astype(bool).tolist() == predictor.in_range(points).tolist()
    assert set(in_range[:, 0]) == {0.0, 1.0}


def test_graph_is_one_that_old_runtimes_load_and_names_what_it_holds():
    predictor, _ = fitted_predictor(3, 5)
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
    predictor, features = fitted_predictor(5, 3)
    path = tmp_path / "predictor.onnx"
    onnx.save(to_onnx(predictor, 5), path)
    for column in range(5):
        point = 0.5 * features[:1].copy()
        point[0, column] = np.nan
        _, in_range, half_width_m = graph_outputs(path, point)
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
