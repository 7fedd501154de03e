"""Predictor and lagged estimator on the robot, against the models that were trained."""

import gc
import math
import tracemalloc

import numpy as np
import onnx
import pytest

from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.estimator import LaggedEstimator
from firmware_py.inference.predictor import OnnxPredictor
from models.predictor.fallback import lagged_features


@pytest.fixture
def predictor(toy_bundle):
    return OnnxPredictor(toy_bundle / "predictor.onnx", 1)


def test_answers_what_the_training_room_would(predictor, toy_fallback):
    rows = toy_fallback.samples.features("observer")[::50]
    for row in rows:
        answer = predictor.predict(row[:1], row[1:2], row[2])
        expected = toy_fallback.predictor.predict(row[None])[0]
        np.testing.assert_allclose(answer.tip_m, expected, rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            answer.half_width_m, toy_fallback.predictor.half_width(row[None])[0], rtol=0, atol=1e-9
        )
        assert answer.in_range is True


def test_range_ends_at_the_bounds_that_the_manifest_names(predictor, toy_bundle):
    features = read_manifest(toy_bundle).features
    low, high = (np.array([getattr(q, end) for q in features]) for end in ("minimum", "maximum"))

    def ask(row):
        return predictor.predict(row[:1], row[1:2], row[2])

    assert ask(low).in_range and ask(high).in_range and ask((low + high) / 2).in_range
    for i in range(3):
        for bound, away in ((low, -np.inf), (high, np.inf)):
            outside = bound.copy()
            outside[i] = np.nextafter(bound[i], away)
            assert not ask(outside).in_range
            at = ask(bound).tip_m.copy()
            outside[i] += np.sign(away)
            np.testing.assert_array_equal(ask(outside).tip_m, at)  # clipped
        missing = (low + high) / 2
        missing[i] = np.nan
        answer = ask(missing)
        assert not answer.in_range
        assert np.isnan(answer.half_width_m).all()


@pytest.mark.slow
def test_a_tick_leaves_nothing_allocated(predictor):
    angle_rad, current_a = np.array([0.1]), np.array([0.4])
    predictor.predict(angle_rad, current_a, 0.002)
    tracemalloc.start()
    try:
        sizes = []
        for _ in range(6):
            for _ in range(500):
                predictor.predict(angle_rad, current_a, 0.002)
            gc.collect()
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # The interpreter's pools grow now and then; what leaks grows every time.
    assert np.diff(sizes).min() < 100, "less than a fifth of a byte a tick"


def test_an_answer_is_not_changed_by_the_next_one(predictor):
    current_a = np.array([0.4])
    answers = [predictor.predict(np.array([a]), current_a, 0.002) for a in (0.0, 0.1, 0.2)]
    assert len({float(a.tip_m[0]) for a in answers}) == 3


@pytest.mark.parametrize("features", ["no JSON", '["angle_1_rad"]', '{"name": "di"}', "[{}]"])
def test_damaged_metadata_are_named(tmp_path, toy_bundle, features):
    graph = onnx.load(toy_bundle / "predictor.onnx")
    del graph.metadata_props[:]
    onnx.helper.set_model_props(graph, {"features": features})
    onnx.save(graph, tmp_path / "predictor.onnx")
    with pytest.raises(InputError, match=r"predictor\.onnx: names its inputs in damaged metadata"):
        OnnxPredictor(tmp_path / "predictor.onnx", 1)


@pytest.mark.parametrize("content", [b"", b"not a graph", None])
def test_a_damaged_graph_is_named(tmp_path, toy_bundle, content):
    path = tmp_path / "predictor.onnx"
    whole = (toy_bundle / "predictor.onnx").read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if content is None else content)
    with pytest.raises(InputError, match=r"predictor\.onnx"):
        OnnxPredictor(path, 1)


def test_a_missing_graph_and_a_graph_of_another_robot_are_named(toy_bundle, tmp_path):
    with pytest.raises(InputError, match="missing"):
        OnnxPredictor(tmp_path / "predictor.onnx", 1)
    with pytest.raises(InputError, match="inputs and outputs"):
        OnnxPredictor(toy_bundle / "predictor.onnx", 2)
    with pytest.raises(InputError, match="inputs and outputs"):
        OnnxPredictor(toy_bundle / "lagged.onnx", 1)


def test_lagged_estimator_runs_like_the_regression_over_the_whole_trial(
    toy_bundle, toy_fallback, toy_trials
):
    manifest = read_manifest(toy_bundle)
    estimator = LaggedEstimator(toy_bundle / "lagged.onnx", manifest.lag_ticks, manifest.dof)
    for trial in toy_trials(1)[:2]:  # the second run must not remember the first
        estimator.reset()
        estimates = [
            estimator.update(angle_rad, current_a, 0.017)
            for angle_rad, current_a in zip(trial.angle_rad, trial.current_a, strict=True)
        ]
        expected = toy_fallback.lagged.predict(lagged_features(trial))[:, 0]
        np.testing.assert_allclose([e.di for e in estimates], expected, rtol=0, atol=1e-9)
        assert all(math.isnan(e.payload_kg) for e in estimates)
