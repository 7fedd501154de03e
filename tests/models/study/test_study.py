"""The study on a toy link whose answers are known, and the command that trains."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from models.__main__ import main
from models.commands.train import name_tests, of_phases, refuse_fitted, refuse_mixed_steps
from models.learning.lagged import LaggedRegressor, lagged_features
from models.learning.samples import collect_samples
from models.learning.validation import r_squared
from models.plant.provenance import FittedTrial, Provenance
from models.plant.simulation.compiled_model import CompiledModel
from models.plant.step_model import names
from models.study.findings import hysteresis_loop
from models.study.observer_runs import run_observer
from models.study.study import run_study
from models.trials.deformation import deformation_index
from models.trials.trial_files import TrialSet, write_trial

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


def test_findings_that_the_toy_was_built_with_come_out(toy_study):
    holds = {f.claim: f.holds for f in toy_study.document.findings}
    assert holds["DI rises with payload"] is True
    assert holds["Degree 1 is worst"] is True
    assert holds["DI helps at every degree"] is True  # the toy's servo has friction
    assert holds["DI shows hysteresis at high payload"] is True  # and its bend lags
    assert holds["Negative angles deform more"] is False  # it is symmetric
    assert holds["2DOF deforms more than 1DOF"] is None  # nothing to compare with


def test_trial_2_chooses_nothing(toy_trials, toy_observer, toy_study):
    training, held_out = toy_trials(1).split()
    scrambled = [
        replace(t, columns=t.columns | {"tip_x_m": t.columns["tip_x_m"][::-1]}) for t in held_out
    ]
    other = run_study(training, name_tests(training, tuple(scrambled)), toy_observer(1))
    assert other.document.chosen_degree == toy_study.document.chosen_degree
    assert other.document.cross_validation == toy_study.document.cross_validation
    assert other.document.mean_euclidean_distance_m != (
        toy_study.document.mean_euclidean_distance_m
    )
    features = toy_study.training.features("observer")
    np.testing.assert_array_equal(
        other.predictor.predict(features), toy_study.predictor.predict(features)
    )


def test_the_chosen_degree_has_the_least_cross_validation_error(toy_study):
    by_degree = toy_study.document.cross_validation["estimated_di"]
    errors = {degree: entry.selection_m for degree, entry in by_degree.items()}
    assert errors[str(toy_study.document.chosen_degree)] == min(errors.values())
    assert all(entry.leave_one_payload_out_m > 0 for entry in by_degree.values())


@pytest.mark.parametrize("dof", [1, 2])
def test_observer_over_a_trial_is_the_step_model_step_by_step(toy_trials, toy_observer, dof):
    trial, model = toy_trials(dof)[0], toy_observer(dof)
    u = np.column_stack([trial.columns[name] for name in names(model.inputs)])
    stepped = model.simulate(u, trial.step_s)[1:]
    observation = run_observer(CompiledModel(model), trial)
    np.testing.assert_allclose(observation.di, stepped[:, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(observation.tip_m, stepped[:, 1:4], rtol=0, atol=1e-12)
    np.testing.assert_allclose(observation.payload_kg, stepped[:, 4], rtol=0, atol=1e-12)


def test_lagged_features_look_back_and_hold_before_the_first_sample():
    angle_rad, current_a = np.arange(6.0)[:, None], 10 + np.arange(6.0)[:, None]
    features = lagged_features(angle_rad, current_a, (0, 2))
    np.testing.assert_array_equal(features[0], [0, 10, 0, 10])
    np.testing.assert_array_equal(features[5], [5, 15, 3, 13])


def test_lagged_regressor_tells_di_on_the_motion_it_knows(toy_trials):
    training, held_out = toy_trials(1).split()
    repeated = held_out.where(lambda t: t.meta.trial == 2)
    lagged = LaggedRegressor.fit(tuple(training), [deformation_index(t) for t in training])
    true = np.concatenate([deformation_index(t)[t.moving] for t in repeated])
    estimate = np.concatenate([lagged.estimate(t)[t.moving] for t in repeated])
    assert r_squared(true, estimate) > 0.8


def test_rows_without_any_marker_are_left_out(toy_trials):
    trial = toy_trials(1)[0]
    hidden = np.r_[100:110]
    columns = {
        name: np.where(np.isin(np.arange(len(trial)), hidden), np.nan, column)
        if name.startswith("m") and name[1:3].isdigit()
        else column
        for name, column in trial.columns.items()
    }
    blind = replace(trial, columns=columns)
    samples = collect_samples((blind,), {"true": [deformation_index(blind)]})
    assert len(samples) == len(trial) - trial.meta.rest_samples - len(hidden)
    assert np.isfinite(samples.features("true")).all()


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


def test_tests_are_named_by_what_they_are(toy_trials):
    training, held_out = toy_trials(1).split()

    def changed(original, **changes):
        return replace(original, meta=msgspec.structs.replace(original.meta, **changes))

    multisine = changed(held_out[0], motion="multisine", amplitude_rad=0.35)
    third = changed(training[0], trial=3)
    ahead = changed(held_out[0], amplitude_rad=training[0].meta.amplitude_rad, phase_2_rad=0.7854)
    named = name_tests(training, (*held_out, multisine, third, ahead))
    assert list(named) == [
        "trial_2", "trial_3", "unseen_20deg", "unseen_multisine_20deg", "unseen_phase_45deg_30deg",
    ]  # fmt: skip


def test_phases_are_chosen_among_2dof_trials_only(toy_trials):
    one, two = toy_trials(1), toy_trials(2)
    ahead = replace(two[0], meta=msgspec.structs.replace(two[0].meta, phase_2_rad=np.pi / 2))
    trials = TrialSet((*one, *two, ahead))
    assert of_phases(trials, None, "DIR") is trials
    assert of_phases(trials, [90.0], "DIR").trials == (*one, ahead)
    assert of_phases(trials, [0.0, 90.0], "DIR").trials == trials.trials
    with pytest.raises(InputError, match=r"45 degrees.*--phase-deg 45"):
        of_phases(trials, [0.0, 45.0], "DIR")


def fitted(name, trial):
    return Provenance(fitted_trials=(FittedTrial(name, trial.sha256()),))


def test_an_unseen_trial_that_the_plant_was_fitted_on_is_refused(toy_trials):
    training, held_out = toy_trials(1).split()
    tests = name_tests(training, tuple(held_out))
    seen = tests["unseen_20deg"][0]
    refuse_fitted(fitted("a", training[0]), "plant.json", tests)
    with pytest.raises(InputError, match=seen.name):
        refuse_fitted(fitted("another name", seen), "plant.json", tests)


def test_runs_too_short_for_blocks_are_refused(toy_trials, toy_observer):
    training, _ = toy_trials(1).split()
    short = TrialSet(
        tuple(replace(t, columns={name: c[:80] for name, c in t.columns.items()}) for t in training)
    )
    with pytest.raises(InputError, match="too few"):
        run_study(short, {}, toy_observer(1))


def test_trials_of_another_time_step_are_refused(toy_trials):
    first, second, *_ = toy_trials(1)
    slower = replace(second, columns=second.columns | {"time_s": 2 * second.columns["time_s"]})
    refuse_mixed_steps((first, second))
    with pytest.raises(InputError, match=r"0\.034 s.*0\.017 s"):
        refuse_mixed_steps((first, slower))


def test_train_writes_a_bundle_and_says_how_to_make_an_unseen_motion(toy_trials, tmp_path, capsys):
    for trial in toy_trials(1, amplitudes_deg=(30,)):
        write_trial(trial, tmp_path / "trials")
    arguments = ["train", str(tmp_path / "trials"), "--dof", "1", "--out", str(tmp_path / "out"),
                 "--plant", "models/plant/nominal.toml"]  # fmt: skip
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "no unseen motion" in text and "--amplitude-deg 20" in text
    assert (tmp_path / "out" / "manifest.json").is_file()
    assert main([*arguments[:3], "2", *arguments[4:]]) == 2
    assert "2DOF" in capsys.readouterr().err
