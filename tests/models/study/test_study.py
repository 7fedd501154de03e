"""The paper's study on a toy link whose results are known."""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.bundle.train import name_tests
from models.plant.simulation.runner import CompiledModel
from models.predictor.fallback import fit_fallback
from models.study.document import read_study, write_study
from models.study.study import run_study

DEGREES = ["1", "2", "3", "4", "5", "6"]


def study_of(training, observer):
    return run_study(fit_fallback(training, CompiledModel(observer(1))), {})


def test_no_test_trial_influences_a_choice(toy_trials, toy_fallback, toy_study):
    training, held_out = toy_trials(1).split()
    scrambled = [
        replace(t, columns=t.columns | {"tip_x_m": t.columns["tip_x_m"][::-1]}) for t in held_out
    ]
    other = run_study(toy_fallback, name_tests(training, tuple(scrambled)))
    assert other.chosen_degree == toy_study.chosen_degree
    assert other.cross_validation == toy_study.cross_validation
    assert other.mean_euclidean_distance_m != toy_study.mean_euclidean_distance_m


def test_tables_have_the_keys_of_the_contract_and_the_best_degree_is_chosen(toy_study):
    table = toy_study.mean_euclidean_distance_m
    assert list(table) == ["trial_2", "unseen_20deg"]
    for by_part in table.values():
        assert list(by_part) == ["pooled", "0", "1", "2"]
        for by_variant in by_part.values():
            assert list(by_variant) == ["with_di", "without_di", "estimated_di"]
            assert all(list(by_degree) == DEGREES for by_degree in by_variant.values())
    by_degree = toy_study.cross_validation["estimated_di"]
    errors = {degree: entry.selection_m for degree, entry in by_degree.items()}
    assert errors[str(toy_study.chosen_degree)] == min(errors.values())
    assert list(toy_study.mean_di) == ["0", "1", "2"]
    pooled, *payloads = (part["with_di"]["3"] for part in table["trial_2"].values())
    assert pooled == pytest.approx(np.mean(payloads)), "the runs have equal lengths"


def test_the_exact_observer_recovers_what_true_di_gains(toy_study):
    for test in ("trial_2", "unseen_20deg"):
        estimators = toy_study.estimators[test]
        assert estimators["observer"].benefit_recovered["3"] > 0.9
        assert estimators["observer"].r2_di > 0.9
        assert set(estimators["none"].benefit_recovered.values()) <= {0.0, None}
    baseline = toy_study.baselines["trial_2"]
    assert baseline.observer_tip["pooled"] < 0.1 * baseline.rigid_kinematics["pooled"]
    assert baseline.rigid_kinematics["2"] > baseline.rigid_kinematics["0"]
    assert toy_study.deployed["trial_2"].interval_coverage_mean > 0.9


def test_findings_are_those_that_the_toy_was_built_with(toy_study):
    holds = {f.claim: f.holds for f in toy_study.findings}
    assert holds["DI rises with payload"] is True
    assert holds["Degree 1 is worst"] is True
    assert holds["DI helps at every degree"] is True  # the toy's servo has friction
    assert holds["DI shows hysteresis at high payload"] is True  # and its bend lags
    assert holds["Negative angles deform more"] is False  # it is symmetric
    assert holds["2DOF deforms more than 1DOF"] is None  # nothing to compare with


def test_a_study_is_read_as_it_was_written_and_of_this_version_only(toy_study, tmp_path):
    path = tmp_path / "study.json"
    write_study(path, toy_study)
    assert read_study(path) == toy_study
    path.write_text(json.dumps(msgspec.to_builtins(toy_study) | {"schema": 1}))
    with pytest.raises(InputError, match=r"schema version 1.*dropstitch train") as refused:
        read_study(path)
    assert "\n" not in str(refused.value)


def test_one_payload_has_no_cross_validation_over_payloads(toy_trials, toy_observer, tmp_path):
    """Keys of the cross-validation are absent, not null, where they do not apply."""
    training, _ = toy_trials(1).split()
    one = training.where(lambda t: t.meta.payload_kg == 1.0)
    write_study(tmp_path / "study.json", study_of(one, toy_observer))
    errors = json.loads((tmp_path / "study.json").read_text())["cross_validation"]["with_di"]["3"]
    assert set(errors) == {"blocks_m", "selection_m"}
    assert errors["selection_m"] == errors["blocks_m"]
