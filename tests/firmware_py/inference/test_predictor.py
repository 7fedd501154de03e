"""Predictor and lagged estimator on the robot: parity with training, batches, ranges."""

import json
import math
from dataclasses import replace

import msgspec
import numpy as np
import onnx
import pytest

from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.documents import read_document
from firmware_py.core.errors import InputError
from firmware_py.core.signals import DI, IN_RANGE, PAYLOAD, tip_names
from firmware_py.inference.batch_prediction import predict_rows
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.estimator import LaggedEstimator
from firmware_py.inference.predictor import InputRange, OnnxPredictor
from firmware_py.inference.range_check import RangeCount, RangeWatch
from firmware_py.summary import RunDocument
from models.predictor.fallback import lagged_features


@pytest.fixture
def predictor(toy_bundle):
    return OnnxPredictor(toy_bundle / "predictor.onnx", 1)


def test_answers_what_the_training_room_would(predictor, toy_fallback):
    rows = toy_fallback.samples.features("observer")[::50]
    answers = [predictor.predict(row[:1], row[1:2], row[2]) for row in rows]
    for row, answer in zip(rows, answers, strict=True):  # no answer changes an earlier one
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


@pytest.mark.parametrize("features", ["no JSON", '["angle_1_rad"]', "[{}]"])
def test_damaged_metadata_are_refused(tmp_path, toy_bundle, features):
    graph = onnx.load(toy_bundle / "predictor.onnx")
    del graph.metadata_props[:]
    onnx.helper.set_model_props(graph, {"features": features})
    onnx.save(graph, tmp_path / "predictor.onnx")
    with pytest.raises(InputError, match=r"predictor\.onnx: names its inputs in damaged metadata"):
        OnnxPredictor(tmp_path / "predictor.onnx", 1)


def test_a_graph_that_is_damaged_missing_or_of_another_robot_is_refused(tmp_path, toy_bundle):
    path, whole = tmp_path / "predictor.onnx", (toy_bundle / "predictor.onnx").read_bytes()
    with pytest.raises(InputError, match=r"predictor\.onnx.*missing"):
        OnnxPredictor(path, 1)
    for content in (b"", b"not a graph", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"predictor\.onnx"):
            OnnxPredictor(path, 1)
    for name, dof in (("predictor.onnx", 2), ("lagged.onnx", 1)):
        with pytest.raises(InputError, match="inputs and outputs"):
            OnnxPredictor(toy_bundle / name, dof)


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


# --- batch prediction -----------------------------------------------------------------------------


ROWS = 120


@pytest.fixture(scope="module")
def bundle(toy_bundle):
    return ModelBundle.load(toy_bundle)


@pytest.fixture
def run():
    phase = np.linspace(0, 6, ROWS)
    return 0.4 * np.sin(phase), 0.8 * np.cos(phase)


def test_rows_are_predicted_as_one_sample_at_a_time(bundle, run):
    angle_rad, current_a = run
    di = np.linspace(0.0, 0.01, ROWS)
    batch = bundle.predict_many(angle_rad, current_a, di)
    one = [
        bundle.predictor.predict(np.array([q]), np.array([i]), d)
        for q, i, d in zip(angle_rad, current_a, di, strict=True)
    ]
    for name in ("tip_m", "half_width_m", "in_range"):
        np.testing.assert_array_equal(getattr(batch, name), [getattr(a, name) for a in one])
    assert len(np.unique(batch.tip_m[:, 0])) == ROWS
    order = np.random.default_rng(0).permutation(ROWS)
    shuffled = bundle.predict_many(angle_rad[order, None], current_a[order, None], di[order])
    np.testing.assert_array_equal(shuffled.tip_m, batch.tip_m[order])
    columns = batch.columns()  # with the names of the log
    assert list(columns)[:3] == list(tip_names("predicted_"))
    assert {"half_width_z_m", IN_RANGE.name, DI.name, PAYLOAD.name} <= columns.keys()
    assert all(len(column) == ROWS for column in columns.values())


def test_a_run_is_followed_by_the_estimator_from_rest(bundle, run):
    first, second = bundle.predict_many(*run), bundle.predict_many(*run)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
    bundle.estimator.reset()
    di = [
        bundle.estimator.update(np.array([q]), np.array([i]), bundle.manifest.period_s).di
        for q, i in zip(*run, strict=True)
    ]
    np.testing.assert_array_equal(first.di, di)
    np.testing.assert_array_equal(bundle.predict_many(*run, first.di).tip_m, first.tip_m)


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        ((np.zeros((5, 2)), np.zeros((5, 2))), "angle_rad"),
        ((np.zeros(5), np.zeros(4)), "current_a"),
        ((np.zeros(5), np.zeros(5), np.zeros(4)), "di"),
        ((0.1, 0.2), "angle_rad"),
        ((np.full(5, np.nan), np.zeros(5)), "angle_rad"),
        ((np.zeros(5), "strong"), "current_a"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(bundle, arguments, where):
    with pytest.raises(InputError, match=f"^{where}: (has|holds|is no)"):
        bundle.predict_many(*arguments)


def test_a_step_and_a_di_that_do_not_fit_the_bundle_are_refused(bundle, run, toy_bundle):
    with pytest.raises(InputError, match="trained at"):
        bundle.predict_many(*run, step_s=0.02)
    predictor = OnnxPredictor(toy_bundle / "predictor.onnx", 1)
    predictor.wanted = ("bend_1_rad",)  # only an observer knows it
    with pytest.raises(InputError, match="bend_1_rad"):
        predict_rows(predictor, np.zeros(3), np.zeros(3), 0.0, 1)


# --- inputs of the predictor that were out of range -----------------------------------------------


@pytest.fixture
def watch(toy_bundle):
    return RangeWatch(ModelBundle.load(toy_bundle))


def predict(watch, angle_rad=0.1, current_a=0.5, di=0.002):
    return watch.predict(np.array([angle_rad]), np.array([current_a]), di)


def test_the_bounds_of_the_graph_count_and_not_the_training_range(toy_bundle):
    bundle = ModelBundle.load(toy_bundle)
    angle, *others = bundle.ranges
    bounded = msgspec.structs.replace(angle, bounds=(-0.75, 0.75))
    watch = RangeWatch(replace(bundle, ranges=(bounded, *others)))
    predict(watch, angle_rad=0.7)
    predict(watch, angle_rad=0.8)
    reasons = watch.reasons()
    assert [row.ticks for row in reasons.inputs] == [1]
    assert reasons.wide_ticks + reasons.other_ticks == 1


def test_each_cause_is_counted_apart():
    """An innovation widens the interval only if the joints move; a late sample widens it, too."""
    bend = InputRange("bend_1_rad", -0.1, 0.1, (-0.15, 0.15))
    innovation = InputRange("innovation_1_a", 0.0, 0.1, (None, 0.15))
    count = RangeCount((bend, innovation))
    narrow, wide = np.full(3, 0.004), np.array([0.004, 0.0, 0.023])
    count.add(np.array([-0.2, 0.05]), narrow)
    count.add(np.array([0.0, 0.4]), wide)
    count.add(np.array([0.0, 0.01]), wide, age_s=0.034)
    count.add(np.array([0.0, 0.01]), 2 * wide)
    count.add(np.array([0.0, 0.4]), narrow)
    count.add(np.array([np.nan, 0.01]), narrow)
    reasons = count.reasons()
    rows = [(row.name, row.ticks, row.extreme) for row in reasons.inputs]
    assert rows == [("bend_1_rad", 1, -0.2), ("innovation_1_a", 1, 0.4)]
    assert (reasons.wide_ticks, reasons.late_ticks, reasons.other_ticks) == (2, 1, 2)
    assert reasons.widest_m == 0.046
    note = reasons.note.replace("\u00a0", " ")
    assert all(words in note for words in ("innovation 1 reached 400.0 mA", "±46.0 mm", "late"))


@pytest.mark.slow
def test_the_summary_of_a_run_names_the_input(servos, config, toy_bundle, tmp_path, call):
    current_a = 20.0
    config.write_text(config.read_text().replace("[limits]", "[limits]\ncurrent_a = 90.0"))
    servos.put(1, Register.PRESENT_CURRENT, round(current_a / MODELS[54024].current_a_per_lsb))
    code, output = call("run", "--config", config)
    assert code == 0, output.err
    (line,) = (line for line in output.out.splitlines() if "training range" in line)
    assert "current 1 reached 19996.6" in line and "mA in" in line and "trained from -" in line
    (path,) = tmp_path.rglob("*.timing.json")
    document = read_document(path, RunDocument)
    beyond = {row.name: row for row in document.out_of_range_reasons.inputs}["current_1_a"]
    assert beyond.ticks == document.out_of_range == document.ticks
    assert beyond.extreme == pytest.approx(current_a, abs=0.1)
    assert beyond.maximum < 19.0
    assert json.loads(path.read_bytes())["out_of_range_reasons"]["inputs"][0]["unit"] == "A"
