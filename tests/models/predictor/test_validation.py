"""Folds, distances, parts of a table and R² against computations by hand."""

import numpy as np
import pytest

from models.predictor.validation import (
    block_folds,
    euclidean_distance_m,
    payload_folds,
    r_squared,
)


def test_blocks_hold_out_every_row_once_and_never_train_within_the_gap():
    time_s = np.concatenate([0.017 * np.arange(512), 0.3 + 0.017 * np.arange(490)])
    run = np.repeat([0, 1], [512, 490])
    folds = block_folds(run, time_s)
    assert len(folds) == 5
    held_out = np.concatenate([test for _, test in folds])
    assert sorted(held_out) == list(range(len(run)))
    for train, test in folds:
        for number in (0, 1):
            trained, tested = time_s[train[run[train] == number]], time_s[test[run[test] == number]]
            assert np.ptp(tested) == pytest.approx(
                np.ptp(time_s[run == number]) / 5, abs=0.035
            )  # two samples
            apart = np.abs(trained[:, None] - tested).min(axis=1)
            assert apart.min() >= 1.0 - 1e-9


def test_payload_folds_never_train_on_the_payload_they_test():
    payload_kg = np.repeat([0.0, 0.5, 2.0], [4, 3, 5])
    folds = payload_folds(payload_kg)
    assert [set(payload_kg[test]) for _, test in folds] == [{0.0}, {0.5}, {2.0}]
    for train, test in folds:
        assert not set(payload_kg[train]) & set(payload_kg[test])
        assert len(train) + len(test) == 12


def test_euclidean_distance_by_hand():
    actual_m = np.array([[0.0, 0, 0], [1, 1, 1], [0.1, 0.2, 0.3]])
    predicted_m = np.array([[0.003, 0.004, 0], [1, 1, 0.988], [0.1, 0.2, 0.3]])
    distance_m = euclidean_distance_m(actual_m, predicted_m)
    np.testing.assert_allclose(distance_m, [0.005, 0.012, 0.0], atol=1e-15)
    assert distance_m.mean() == pytest.approx((0.005 + 0.012) / 3)


def test_r_squared_is_one_for_the_truth_and_zero_for_the_mean():
    actual = np.array([1.0, 2.0, 4.0])
    assert r_squared(actual, actual) == 1.0
    assert r_squared(actual, np.full(3, actual.mean())) == pytest.approx(0.0)
    assert r_squared(actual, -actual) < 0
