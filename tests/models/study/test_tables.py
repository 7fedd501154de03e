"""Tables of the study on a toy link whose results are known."""

import numpy as np
import pytest

DEGREES = ["1", "2", "3", "4", "5", "6"]


def test_tables_have_the_keys_of_the_contract(toy_study):
    table = toy_study.document.mean_euclidean_distance_m
    assert list(table) == ["trial_2", "unseen_20deg"]
    for by_part in table.values():
        assert list(by_part) == ["pooled", "0", "1", "2"]
        for by_variant in by_part.values():
            assert list(by_variant) == ["with_di", "without_di", "estimated_di"]
            assert all(list(by_degree) == DEGREES for by_degree in by_variant.values())
    assert list(toy_study.document.mean_di) == ["0", "1", "2"]


def test_pooled_distance_is_the_mean_over_payloads_of_equal_length(toy_study):
    by_part = toy_study.document.mean_euclidean_distance_m["trial_2"]
    of_payloads = [by_part[kg]["with_di"]["3"] for kg in ("0", "1", "2")]
    assert by_part["pooled"]["with_di"]["3"] == pytest.approx(np.mean(of_payloads))


def test_an_observer_that_knows_the_link_recovers_what_true_di_gains(toy_study):
    for test in ("trial_2", "unseen_20deg"):
        estimators = toy_study.document.estimators[test]
        assert estimators["observer"].benefit_recovered["3"] > 0.9
        assert estimators["observer"].r2_di > 0.9
        assert set(estimators["none"].benefit_recovered.values()) <= {0.0, None}


def test_baselines_tell_a_bent_link_from_a_rigid_one(toy_study):
    baseline = toy_study.document.baselines["trial_2"]
    assert baseline.observer_tip["pooled"] < 0.1 * baseline.rigid_kinematics["pooled"]
    assert baseline.rigid_kinematics["2"] > baseline.rigid_kinematics["0"]
    assert all(abs(kg) < 0.05 for kg in baseline.final_payload_error_kg.values())


def test_interval_covers_trial_2(toy_study):
    assert toy_study.document.deployed["trial_2"].interval_coverage_mean > 0.9
