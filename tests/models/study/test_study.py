"""The paper's study on a toy link whose results are known."""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from models.commands.train import name_tests
from models.plant.simulation.runner import CompiledModel
from models.predictor.fallback import fit_fallback
from models.study.document import read_study, write_study
from models.study.findings import hysteresis_loop
from models.study.study import run_study
from models.trials.trial import TrialSet


def fallback_of(training, observer):
    return fit_fallback(training, CompiledModel(observer(1)))


def test_trial_2_chooses_nothing(toy_trials, toy_fallback, toy_study):
    training, held_out = toy_trials(1).split()
    scrambled = [
        replace(t, columns=t.columns | {"tip_x_m": t.columns["tip_x_m"][::-1]}) for t in held_out
    ]
    other = run_study(training, name_tests(training, tuple(scrambled)), toy_fallback)
    assert other.chosen_degree == toy_study.chosen_degree
    assert other.cross_validation == toy_study.cross_validation
    assert other.mean_euclidean_distance_m != (toy_study.mean_euclidean_distance_m)


def test_the_chosen_degree_has_the_least_cross_validation_error(toy_study):
    by_degree = toy_study.cross_validation["estimated_di"]
    errors = {degree: entry.selection_m for degree, entry in by_degree.items()}
    assert errors[str(toy_study.chosen_degree)] == min(errors.values())
    assert all(entry.leave_one_payload_out_m > 0 for entry in by_degree.values())


def test_runs_too_short_for_blocks_are_refused(toy_trials, toy_observer):
    training, _ = toy_trials(1).split()
    short = TrialSet(
        tuple(replace(t, columns={name: c[:80] for name, c in t.columns.items()}) for t in training)
    )
    with pytest.raises(InputError, match="too few"):
        fallback_of(short, toy_observer)


DEGREES = ["1", "2", "3", "4", "5", "6"]


def test_tables_have_the_keys_of_the_contract(toy_study):
    table = toy_study.mean_euclidean_distance_m
    assert list(table) == ["trial_2", "unseen_20deg"]
    for by_part in table.values():
        assert list(by_part) == ["pooled", "0", "1", "2"]
        for by_variant in by_part.values():
            assert list(by_variant) == ["with_di", "without_di", "estimated_di"]
            assert all(list(by_degree) == DEGREES for by_degree in by_variant.values())
    assert list(toy_study.mean_di) == ["0", "1", "2"]


def test_pooled_distance_is_the_mean_over_payloads_of_equal_length(toy_study):
    by_part = toy_study.mean_euclidean_distance_m["trial_2"]
    of_payloads = [by_part[kg]["with_di"]["3"] for kg in ("0", "1", "2")]
    assert by_part["pooled"]["with_di"]["3"] == pytest.approx(np.mean(of_payloads))


def test_an_observer_that_knows_the_link_recovers_what_true_di_gains(toy_study):
    for test in ("trial_2", "unseen_20deg"):
        estimators = toy_study.estimators[test]
        assert estimators["observer"].benefit_recovered["3"] > 0.9
        assert estimators["observer"].r2_di > 0.9
        assert set(estimators["none"].benefit_recovered.values()) <= {0.0, None}


def test_baselines_tell_a_bent_link_from_a_rigid_one(toy_study):
    baseline = toy_study.baselines["trial_2"]
    assert baseline.observer_tip["pooled"] < 0.1 * baseline.rigid_kinematics["pooled"]
    assert baseline.rigid_kinematics["2"] > baseline.rigid_kinematics["0"]
    assert all(abs(kg) < 0.05 for kg in baseline.final_payload_error_kg.values())


def test_interval_covers_trial_2(toy_study):
    assert toy_study.deployed["trial_2"].interval_coverage_mean > 0.9


def test_findings_that_the_toy_was_built_with_come_out(toy_study):
    holds = {f.claim: f.holds for f in toy_study.findings}
    assert holds["DI rises with payload"] is True
    assert holds["Degree 1 is worst"] is True
    assert holds["DI helps at every degree"] is True  # the toy's servo has friction
    assert holds["DI shows hysteresis at high payload"] is True  # and its bend lags
    assert holds["Negative angles deform more"] is False  # it is symmetric
    assert holds["2DOF deforms more than 1DOF"] is None  # nothing to compare with


def test_a_loop_is_wide_only_where_the_link_lags(make_trial):
    time_s = 0.017 * np.arange(532)
    angle_rad = -0.5 * np.sin(2 * np.pi * np.maximum(time_s - time_s[20], 0) / 4.352)
    bend = 0.01 * angle_rad**2
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(time_s))
    speed = np.abs(np.gradient(angle_rad))
    rising = (np.gradient(angle_rad) > 0) * speed / speed.max()
    follows = hysteresis_loop(make_trial(angle_rad, stretch=1.001 + bend + noise, rest_samples=20))
    lags = hysteresis_loop(
        make_trial(angle_rad, stretch=1.001 + bend + noise + 1e-3 * rising, rest_samples=20)
    )
    assert follows.width < 3 * follows.noise
    assert lags.width > 3 * lags.noise
    assert 0.6e-3 < lags.width < 1e-3  # the branches stand 1e-3 apart at zero, less beside it


def test_a_study_is_read_back_as_it_was_written(toy_study, tmp_path):
    write_study(tmp_path / "study.json", toy_study)
    assert read_study(tmp_path / "study.json") == toy_study


def test_a_study_of_another_version_is_refused_in_one_sentence(toy_study, tmp_path):
    path = tmp_path / "study.json"
    old = msgspec.to_builtins(toy_study) | {"schema": 1}
    path.write_text(json.dumps(old))
    with pytest.raises(InputError) as refused:
        read_study(path)
    message = str(refused.value)
    assert "schema version 1" in message and "dropstitch train" in message
    assert "\n" not in message


def test_one_payload_leaves_out_no_payload(toy_trials, toy_observer, tmp_path):
    """Keys of the cross-validation are absent, not null, where they do not apply."""
    training, _ = toy_trials(1).split()
    one = training.where(lambda t: t.meta.payload_kg == 1.0)
    write_study(tmp_path / "study.json", run_study(one, {}, fallback_of(one, toy_observer)))
    errors = json.loads((tmp_path / "study.json").read_text())["cross_validation"]["with_di"]["3"]
    assert set(errors) == {"blocks_m", "blocks_fold_std_m", "selection_m"}
    assert errors["selection_m"] == errors["blocks_m"]


def test_an_occluded_marker_row_is_null_in_the_poses(toy_trials, toy_observer, tmp_path):
    """All four markers of the first row hidden from the start: the document stays readable."""
    training, _ = toy_trials(1).split()
    hidden = [f"m{i:02d}_{axis}_m" for i in range(1, 5) for axis in "xyz"]
    blind = type(training)(
        tuple(
            replace(t, columns=t.columns | {n: _occluded(t.columns[n], t.meta) for n in hidden})
            for t in training
        )
    )
    path = tmp_path / "study.json"
    write_study(path, run_study(blind, {}, fallback_of(blind, toy_observer)))
    poses = read_study(path).series.poses
    assert poses.centre_line_m[0][1] == (None, None, None)
    assert None not in poses.centre_line_m[0][2]


def _occluded(column, meta):
    """The column without the first moving row, where the first pose is taken."""
    column = column.copy()
    column[meta.rest_samples] = np.nan
    return column
