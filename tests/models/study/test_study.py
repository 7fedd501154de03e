"""Study of a toy link: what chooses the degree, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_py.errors import InputError
from models.commands.train import name_tests
from models.study.study import run_study
from models.trials.trial import TrialSet


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


def test_runs_too_short_for_blocks_are_refused(toy_trials, toy_observer):
    training, _ = toy_trials(1).split()
    short = TrialSet(
        tuple(replace(t, columns={name: c[:80] for name, c in t.columns.items()}) for t in training)
    )
    with pytest.raises(InputError, match="too few"):
        run_study(short, {}, toy_observer(1))
