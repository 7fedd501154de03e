"""CasADi import of an ONNX graph against onnxruntime."""

import casadi as ca
import numpy as np
import onnx
import pytest

from firmware_py.errors import InputError
from models.predictor.onnx_graphs import predictor_function, to_onnx
from tests.models.predictor.graph_cases import fitted_predictor, graph_outputs


@pytest.mark.parametrize(("n", "degree"), [(3, 3), (5, 3), (5, 6)])
def test_casadi_imports_the_same_file(n, degree, tmp_path):
    predictor, features = fitted_predictor(n, degree)
    path = tmp_path / "predictor.onnx"
    onnx.save(to_onnx(predictor, n), path)
    function = predictor_function(path)
    assert function.name_in() == ["features"]
    assert function.name_out() == ["tip_m", "in_range", "half_width_m"]
    points = np.vstack([features[:30], 1.5 * features[:30], [[np.nan] * n]])
    expected = graph_outputs(path, points)
    actual = [function(point) for point in points]
    for k in range(3):
        values = np.array([np.asarray(row[k]).ravel() for row in actual])
        rows = slice(0, -1) if k == 0 else slice(None)  # the tip of a NaN is not specified
        np.testing.assert_allclose(values[rows], expected[k][rows], rtol=0, atol=1e-12)


def test_casadi_differentiates_the_import(tmp_path):
    predictor, features = fitted_predictor(3, 4)
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


def test_a_damaged_graph_is_named(tmp_path):
    (tmp_path / "predictor.onnx").write_bytes(b"not a graph")
    with pytest.raises(InputError, match=r"predictor\.onnx"):
        predictor_function(tmp_path / "predictor.onnx")
