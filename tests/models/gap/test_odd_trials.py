"""Trials of a wrong payload, or disturbed, are left out of a diagnosis and named."""

from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from models.gap.diagnosis import diagnose
from models.gap.estimation.fitted_floor import noise_floor_for
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.outliers import outlier_trials
from models.gap.report.gap_results import gap_document
from models.gap.report.gap_words import gap_in_words
from models.gap.residuals.fit_parameters import candidate_effects, nuisance_and_variation
from models.gap.residuals.residuals import Residuals
from models.trials.trial import TrialSet

FEW = ("backlash", "creep", "viscous_friction", "unmodelled_payload")


def found_in(plant, trials):
    others = [e for e in candidate_effects(plant) if e not in FEW]
    return diagnose(plant, trials, leave_out=others)


def changed(trials, name, change):
    """Trials, one of them changed."""
    return TrialSet(tuple(change(t) if t.name == name else t for t in trials))


def bumped(trial):
    """A trial in which somebody pushed the arm for a third of a second."""
    push = np.zeros(len(trial))
    push[150:170] = np.hanning(20)
    columns = {
        **trial.columns,
        "angle_1_rad": trial.columns["angle_1_rad"] + 0.02 * push,
        "current_1_a": trial.columns["current_1_a"] + 4.0 * push,
        "tip_x_m": trial.columns["tip_x_m"] + 0.1 * push,
    }
    return replace(trial, columns=columns)


def mislabelled(trial):
    """A trial with 1 kg of which somebody noted nothing."""
    return replace(trial, meta=msgspec.structs.replace(trial.meta, payload_kg=0.0, trial=3))


@pytest.mark.slow
@pytest.mark.parametrize("change", [bumped, mislabelled])
def test_the_trial_is_left_out_and_told_and_nothing_is_named(plant, hidden, change):
    trials = hidden()
    name = next(t.name for t in trials if t.meta.payload_kg == 1.0 and t.meta.trial == 2)
    trials = changed(trials, name, change)
    odd = next(t.name for t in trials if t.meta.trial == 3 or t.name == name)
    found = found_in(plant, trials)
    assert [o.name for o in found.outliers] == [odd]
    assert (found.named, found.verdict) == ((), "no gap")
    document = gap_document(found)
    assert [o.name for o in document.odd_trials] == [odd]
    assert odd in gap_in_words(document)


@pytest.mark.slow
def test_an_effect_is_found_beside_a_disturbed_trial(plant, hidden):
    trials = hidden(viscous_friction_1_nm_s_rad=4.0)
    name = next(t.name for t in trials if t.meta.payload_kg == 1.0)
    found = found_in(plant, changed(trials, name, bumped))
    assert [o.name for o in found.outliers] == [name]
    assert found.named == ("viscous_friction",)


@pytest.mark.slow
@pytest.mark.parametrize(
    "strengths",
    [{}, {"viscous_friction_1_nm_s_rad": 4.0}, {"dead_time_1_s": 0.02}, {"backlash_1_rad": 0.02}],
)
def test_an_effect_makes_no_trial_odd(plant, hidden, strengths):
    trials = hidden(**strengths).trials
    residuals = Residuals(plant, trials, nuisance_and_variation(plant, trials))
    estimator = GaussNewton(residuals, noise_floor_for(residuals))
    assert outlier_trials(estimator, estimator.fit_nuisance(estimator.start())) == ()


@pytest.mark.parametrize(
    ("payloads_kg", "levels", "odd"),
    [
        ((0.0, 0.0, 1.0, 1.0), (1.0, 1.2, 1.1, 2.5), [3]),
        ((0.0, 0.0, 1.0, 1.0), (1.0, 1.2, 4.0, 7.0), []),
        ((0.0, 1.0, 2.0, 0.5), (1.0, 1.2, 1.1, 2.5), []),
        ((0.0, 1.0, 2.0, 0.5), (1.0, 1.2, 1.1, 4.0), [3]),
        ((0.0, 1.0, 2.0, 2.5), (1.0, 1.2, 1.1, 9.0), []),
    ],
)
def test_a_trial_is_odd_by_its_repetition_else_by_trials_of_less_and_more_load(
    monkeypatch, payloads_kg, levels, odd
):
    monkeypatch.setattr("models.gap.outliers._levels", lambda *_: np.array(levels))
    monkeypatch.setattr("models.gap.outliers.group_frequencies_hz", lambda *_: np.zeros(1))
    trials = [
        SimpleNamespace(name=str(k), path="", meta=SimpleNamespace(payload_kg=kg))
        for k, kg in enumerate(payloads_kg)
    ]
    group = SimpleNamespace(trials=range(len(trials)), signals=())
    estimator = SimpleNamespace(
        residuals=SimpleNamespace(trials=trials, groups=[group]), means=[np.zeros(1)], floor=None
    )
    found = outlier_trials(estimator, SimpleNamespace(rows=[np.zeros(1)]))
    assert [int(o.name) for o in found] == odd
