"""Batch prediction: arrays in, arrays out, the same as one sample at a time."""

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.signals import DI, IN_RANGE, PAYLOAD, tip_names
from firmware_py.inference.batch_prediction import predict_rows
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.predictor import OnnxPredictor

ROWS = 120


@pytest.fixture(scope="module")
def bundle(toy_bundle):
    return ModelBundle.load(toy_bundle)


@pytest.fixture
def run():
    phase = np.linspace(0, 6, ROWS)
    return 0.4 * np.sin(phase), 0.8 * np.cos(phase)


def test_rows_are_predicted_one_by_one_and_kept(bundle, run):
    angle_rad, current_a = run
    di = np.linspace(0.0, 0.01, ROWS)
    found = bundle.predict_many(angle_rad, current_a, di)
    one = [
        bundle.predictor.predict(np.array([q]), np.array([i]), d)
        for q, i, d in zip(angle_rad, current_a, di, strict=True)
    ]
    np.testing.assert_array_equal(found.tip_m, [a.tip_m for a in one])
    np.testing.assert_array_equal(found.half_width_m, [a.half_width_m for a in one])
    np.testing.assert_array_equal(found.in_range, [a.in_range for a in one])
    assert len(np.unique(found.tip_m[:, 0])) == ROWS
    order = np.random.default_rng(0).permutation(ROWS)
    shuffled = bundle.predict_many(angle_rad[order, None], current_a[order, None], di[order])
    np.testing.assert_array_equal(shuffled.tip_m, found.tip_m[order])


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
    given = bundle.predict_many(*run, first.di)
    np.testing.assert_array_equal(given.tip_m, first.tip_m)


def test_the_columns_have_the_names_of_the_log(bundle, run):
    columns = bundle.predict_many(*run).columns()
    assert list(columns)[:3] == list(tip_names("predicted_"))
    assert {"half_width_z_m", IN_RANGE.name, DI.name, PAYLOAD.name} <= columns.keys()
    assert all(len(column) == ROWS for column in columns.values())


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


def test_a_step_is_refused_that_the_estimator_does_not_know(bundle, run):
    with pytest.raises(InputError, match="trained at"):
        bundle.predict_many(*run, step_s=0.02)


def test_a_predictor_that_wants_the_observer_does_not_take_a_di(toy_bundle):
    predictor = OnnxPredictor(toy_bundle / "predictor.onnx", 1)
    predictor.wanted = ("bend_1_rad",)
    with pytest.raises(InputError, match="bend_1_rad"):
        predict_rows(predictor, np.zeros(3), np.zeros(3), 0.0, 1)
