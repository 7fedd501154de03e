"""Polynomials: fit, interval, power form, graph, and import into CasADi."""

import itertools
import json

import casadi as ca
import numpy as np
import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.linear_model import LinearRegression
from sklearn.preprocessing import PolynomialFeatures

from firmware_py.errors import InputError
from models.predictor.onnx_graphs import predictor_function, to_onnx
from models.predictor.polynomials import (
    GuardedPredictor,
    Polynomial,
    polynomial_pipeline,
    power_form,
    predict,
)
from tests.models.predictor.cases import fitted_predictor, graph_outputs

SIZES = st.tuples(st.integers(1, 5), st.integers(1, 6), st.integers(0, 2**32 - 1))


@given(SIZES)
@settings(max_examples=25, deadline=None)
def test_polynomial_reads_what_scikit_learn_fitted(size):
    n, degree, seed = size
    rng = np.random.default_rng(seed)
    features = rng.uniform(-2, 5, (3000, n))
    targets = rng.standard_normal((3000, 2))
    pipeline = polynomial_pipeline(degree).fit(features, targets)
    polynomial = Polynomial.of(pipeline)
    assert polynomial.degree == degree
    np.testing.assert_allclose(
        polynomial(features[:50]), predict(pipeline, features[:50]), atol=1e-10
    )


def test_coefficients_in_si_units_are_those_of_the_papers_equation():
    rng = np.random.default_rng(1)
    features = np.column_stack([rng.uniform(-0.5, 0.5, 500), rng.uniform(0, 0.01, 500)])
    angle, di = features.T
    targets = np.column_stack([0.3 + 2 * angle - 7 * angle * di, 5 * di**2])
    beta = Polynomial.of(polynomial_pipeline(2).fit(features, targets)).in_si_units()
    assert list(beta)[:3] == [(0, 0), (1, 0), (0, 1)]
    np.testing.assert_allclose(beta[0, 0], [0.3, 0], atol=1e-9)
    np.testing.assert_allclose(beta[1, 0], [2, 0], atol=1e-9)
    np.testing.assert_allclose(beta[1, 1], [-7, 0], atol=1e-7)
    np.testing.assert_allclose(beta[0, 2], [0, 5], rtol=1e-4, atol=1e-4)


def test_unscaled_fit_loses_rank_that_the_scaled_fit_keeps():
    """Why the pipeline scales: degrees beside a DI of 0.01, at degree 6.

    docs/sources.md, "ONNX".
    """
    rng = np.random.default_rng(2)
    features = np.column_stack(
        [rng.uniform(-30, 30, 2000), rng.uniform(-3, 3, 2000), rng.uniform(0, 0.01, 2000)]
    )
    targets = np.sin(features @ [0.05, 0.3, 100.0])[:, None]
    raw = PolynomialFeatures(6, include_bias=False).fit_transform(features)
    unscaled = targets - LinearRegression().fit(raw, targets).predict(raw)
    scaled = targets - predict(polynomial_pipeline(6).fit(features, targets), features)
    assert np.sqrt(np.mean(unscaled**2)) > 10 * np.sqrt(np.mean(scaled**2))


def some_folds(count, parts=5):
    rows = np.random.default_rng(0).permutation(count)
    return [(np.setdiff1d(rows, part), part) for part in np.array_split(rows, parts)]


def guarded(n=3, degree=2, seed=0, noise=None, count=400):
    rng = np.random.default_rng(seed)
    features = rng.uniform(-1, 1, (count, n)) * np.array([0.5, 3.0, 0.01])[:n]
    noise = rng.standard_normal if noise is None else noise

    def truth(x):
        return np.column_stack([x[:, 0] ** 2, x.sum(axis=1), 100 * x[:, 0] * x[:, -1]])

    targets = truth(features) + 0.002 * noise((count, 3))
    predictor = GuardedPredictor.fit(degree, features, targets, some_folds(count))
    return predictor, features, truth


@pytest.mark.parametrize("law", ["normal", "heavy tails"])
def test_interval_covers_95_percent_of_fresh_data(law):
    covered = []
    for seed in range(40):
        rng = np.random.default_rng(1000 + seed)
        noise = rng.standard_normal if law == "normal" else lambda s, r=rng: r.standard_t(3, s)
        predictor, features, truth = guarded(seed=seed, noise=noise)
        fresh = rng.uniform(features.min(axis=0), features.max(axis=0), (400, 3))
        actual = truth(fresh) + 0.002 * noise((400, 3))
        inside = np.abs(actual - predictor.predict(fresh)) <= predictor.half_width(fresh)
        covered.append(inside.mean())
    assert 0.94 < np.mean(covered) < 0.965


def test_leverage_is_that_of_the_quadratic_regression():
    predictor, features, _ = guarded()
    z = features * predictor.leverage.scale + predictor.leverage.offset
    phi = PolynomialFeatures(2).fit_transform(z)
    hat = phi @ np.linalg.solve(phi.T @ phi, phi.T)
    np.testing.assert_allclose(predictor.leverage(features)[:, 0], np.diag(hat), rtol=1e-4)
    assert np.sum(np.diag(hat)) == pytest.approx(phi.shape[1])


def test_interval_widens_outside_the_training_data():
    predictor, features, _ = guarded()
    inside = predictor.half_width(features).max(axis=0)
    assert np.all(predictor.half_width(3 * features[:20] / np.abs(features[:20]) * 0.5) > inside)


def test_guard_clips_and_reports_the_range():
    predictor, features, _ = guarded()
    upper = features.max(axis=0)
    at, beyond = upper[None], (upper + np.array([1e-6, 0, 0]))[None]
    assert predictor.in_range(at)[0] and not predictor.in_range(beyond)[0]
    np.testing.assert_allclose(predictor.predict(upper[None] + 5), predictor.predict(at), rtol=1e-6)
    assert not predictor.in_range(np.array([[np.nan, 0, 0]]))[0]


def test_a_link_at_rest_is_in_range_whatever_the_rounding_of_its_smallest_di():
    predictor, features, _ = guarded()
    for edge in (features.min(axis=0), features.max(axis=0)):
        rounded = edge * (1 + np.array([[4e-14], [-4e-14]]))
        assert predictor.in_range(rounded).all()


SIZES = st.tuples(st.integers(1, 5), st.integers(1, 6), st.integers(0, 2**32 - 1))


def random_polynomial(n, degree, rng, outputs=3):
    exponents = [e for e in itertools.product(range(degree + 1), repeat=n) if sum(e) <= degree]
    return Polynomial(
        scale=rng.uniform(0.3, 3.0, n),
        offset=rng.uniform(-0.5, 0.5, n),
        exponents=np.array(exponents),
        coefficients=rng.standard_normal((len(exponents), outputs)),
    )


@given(SIZES)
@settings(max_examples=40, deadline=None)
def test_power_form_equals_the_monomials(size):
    n, degree, seed = size
    rng = np.random.default_rng(seed)
    polynomial = random_polynomial(n, degree, rng)
    points = (rng.uniform(-1, 1, (50, n)) - polynomial.offset) / polynomial.scale
    rows, bias, weights = power_form(polynomial)
    expected = polynomial(points)
    difference = ((points @ rows + bias) ** degree) @ weights - expected
    assert np.abs(difference).max() < 1e-11 * max(1.0, np.abs(expected).max())


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
