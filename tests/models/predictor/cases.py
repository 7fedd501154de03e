"""Fitted predictors, outputs of their graphs by onnxruntime, and rows of a made-up link."""

import numpy as np
import onnx
import onnxruntime as ort

from models.predictor.candidates import ObserverTip
from models.predictor.guarded_tip import GuardedTip
from models.predictor.interval import TipInterval
from models.predictor.observed_trials import TipRows, input_names
from models.predictor.onnx_graphs import predictor_function, to_onnx
from models.predictor.polynomials import GuardedPredictor


def fitted_predictor(n, degree):
    rng = np.random.default_rng(0)
    size = np.array([0.5, 0.5, 3.0, 3.0, 0.005])[[0, 2, 4] if n == 3 else slice(None)]
    features = rng.uniform(-1, 1, (1500, n)) * size
    targets = np.column_stack([np.sin(0.3 * features @ rng.normal(size=n) + k) for k in range(3)])
    folds = [(np.arange(300, 1500), np.arange(300))]
    return GuardedPredictor.fit(degree, features, targets, folds), features


def saved_graph(model, points, path):
    onnx.save(to_onnx(model.write_graph, points.shape[1]), path)
    return path


def graph_outputs(path, points):
    """Tip, range and half width of each point, by onnxruntime."""
    session = ort.InferenceSession(path)
    rows = [session.run(None, {"features": point[None]}) for point in points]
    return [np.array([row[k][0] for row in rows]) for k in range(3)]


def assert_graphs_agree(model, points, path, tolerance):
    """The file, by onnxruntime and by CasADi, answers what the model does in Python."""
    tip_m, in_range, half_width_m = graph_outputs(saved_graph(model, points, path), points)
    np.testing.assert_allclose(tip_m, model.predict(points), rtol=0, atol=tolerance)
    np.testing.assert_allclose(half_width_m, model.half_width(points), rtol=0, atol=tolerance)
    np.testing.assert_array_equal(in_range[:, 0], model.in_range(points).astype(float))
    imported = predictor_function(path)
    for point, *expected in zip(points, tip_m, in_range, half_width_m, strict=True):
        answer = imported(features=point)
        for name, value in zip(("tip_m", "in_range", "half_width_m"), expected, strict=True):
            np.testing.assert_allclose(answer[name].full().ravel(), value, rtol=0, atol=tolerance)


SIZE = {"m": 0.3, "rad": 0.4, "rad_s": 0.5, "a": 0.1, "kg": 0.5, "di": 0.005, "s": 0.0}


def made_up_rows(dof=1, count=1200, seed=0, bias_m=0.0, payloads_kg=(0.0, 1.0, 2.0)):
    """Rows of six trials: the observer is off by a quadratic in the bend, a bias and noise."""
    rng = np.random.default_rng(seed)
    names = input_names(dof)
    inputs = np.zeros((count, len(names)))
    run = np.repeat(np.arange(6), count // 6)
    for k, name in enumerate(names):
        unit = next((u for u in ("rad_s", "rad", "kg", "_a", "_m", "di") if name.endswith(u)), "s")
        inputs[:, k] = SIZE[unit.lstrip("_")] * rng.uniform(-1, 1, count)
        if name.startswith(("innovation", "payload")) or name.endswith("deviation_m"):
            inputs[:, k] = 0.01 * np.abs(inputs[:, k])
    payload_kg = np.array(payloads_kg)[run % len(payloads_kg)]
    tip_m = inputs[:, [names.index(f"tip_{axis}_m") for axis in "xyz"]].copy()
    bend = inputs[:, names.index("bend_1_rad")]
    tip_m += np.column_stack([0.02 * bend**2, 0.01 * bend, 0 * bend])
    tip_m += bias_m * rng.standard_normal((6, 3))[run] + 3e-4 * rng.standard_normal((count, 3))
    return TipRows(
        names, inputs, tip_m, payload_kg, np.where(run < 3, "sinusoid", "multisine"), run,
        np.where(np.arange(count) % 7 == 0, "rest", "motion"),
    )  # fmt: skip


def guarded(rows, predictor=None):
    """A predictor of these rows, the observer's tip by default, with interval and range."""
    predictor = predictor or ObserverTip(0).fit(rows)
    error_m = rows.tip_m - predictor.predict(rows.inputs)
    interval = TipInterval.fit(rows.names, (rows.inputs, error_m, rows.run))
    return GuardedTip.of(rows, predictor, interval)
