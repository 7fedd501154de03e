"""Polynomials: fit, interval, power form, graph, and import into CasADi."""

import json

import numpy as np
import pytest
from sklearn.model_selection import KFold

from firmware_py.core.errors import InputError
from models.predictor.onnx_graphs import predictor_function, to_onnx
from models.predictor.polynomials import (
    GuardedPredictor,
)
from tests.models.predictor.cases import (
    assert_graphs_agree,
    fitted_predictor,
)


def truth(x):
    return np.column_stack([x[:, 0] ** 2, x.sum(axis=1), 100 * x[:, 0] * x[:, -1]])


def guarded(seed=0, noise=None):
    rng = np.random.default_rng(seed)
    features = rng.uniform(-1, 1, (400, 3)) * np.array([0.5, 3.0, 0.01])
    targets = truth(features) + 0.002 * (noise or rng.standard_normal)((400, 3))
    folds = KFold(5, shuffle=True, random_state=0).split(features)
    return GuardedPredictor.fit(2, features, targets, folds), features


@pytest.mark.slow
@pytest.mark.parametrize("law", ["normal", "heavy tails"])
def test_interval_covers_95_percent_of_fresh_data(law):
    covered = []
    for seed in range(40):
        rng = np.random.default_rng(1000 + seed)
        noise = rng.standard_normal if law == "normal" else lambda s, r=rng: r.standard_t(3, s)
        predictor, features = guarded(seed, noise)
        fresh = rng.uniform(features.min(axis=0), features.max(axis=0), (400, 3))
        actual = truth(fresh) + 0.002 * noise((400, 3))
        inside = np.abs(actual - predictor.predict(fresh)) <= predictor.half_width(fresh)
        covered.append(inside.mean())
    assert 0.94 < np.mean(covered) < 0.965


def test_guard_clips_and_reports_the_range():
    """The DI of a link at rest is the smallest: rounding does not put it out of range."""
    predictor, features = guarded()
    lower, upper = features.min(axis=0), features.max(axis=0)
    rounding = 1 + np.array([[4e-14], [-4e-14]])
    assert predictor.in_range(np.vstack([lower * rounding, upper * rounding])).all()
    beyond = upper + np.array([[1e-6, 0, 0], [np.nan, 0, 0]])
    assert not predictor.in_range(beyond).any()
    np.testing.assert_allclose(
        predictor.predict(upper[None] + 5), predictor.predict(upper[None]), rtol=1e-6
    )


@pytest.mark.parametrize(("n", "degree"), [(3, 1), (3, 5), (5, 6)])
def test_graphs_answer_what_scikit_learn_does(n, degree, tmp_path):
    predictor, features = fitted_predictor(n, degree)
    points = np.vstack([features[:40], 1.5 * features[:40]])  # half of them out of range
    assert_graphs_agree(predictor, points, tmp_path / "predictor.onnx", 1e-11)
    assert 20 < predictor.in_range(points).sum() < 80


def test_graph_is_one_that_old_runtimes_load_and_describes_itself():
    predictor, _ = fitted_predictor(3, 5)
    facts = {"features": [{"name": "di", "unit": "1"}], "dof": 1}
    graph, again = (to_onnx(predictor.write_graph, 3, facts) for _ in range(2))
    assert graph.ir_version == 7
    assert [(o.domain, o.version) for o in graph.opset_import] == [("", 13)]
    assert len(graph.graph.node) < 25
    assert {prop.key: json.loads(prop.value) for prop in graph.metadata_props} == facts
    assert graph.SerializeToString() == again.SerializeToString()


def test_a_damaged_graph_is_refused_by_its_name(tmp_path):
    (tmp_path / "predictor.onnx").write_bytes(b"not a graph")
    with pytest.raises(InputError, match=r"predictor\.onnx"):
        predictor_function(tmp_path / "predictor.onnx")
