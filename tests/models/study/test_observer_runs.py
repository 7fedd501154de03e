"""Runs of the observer against its step model."""

import numpy as np
import pytest

from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names
from models.predictor.observed_trials import run_observer


@pytest.mark.parametrize("dof", [1, 2])
def test_observer_over_a_trial_is_the_step_model_step_by_step(toy_trials, toy_observer, dof):
    trial, model = toy_trials(dof)[0], toy_observer(dof)
    u = np.column_stack([trial.columns[name] for name in names(model.inputs)])
    stepped = model.simulate(u, trial.step_s)[1:]
    observation = run_observer(CompiledModel(model), trial)
    np.testing.assert_allclose(observation.di, stepped[:, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(observation.tip_m, stepped[:, 1:4], rtol=0, atol=1e-12)
    np.testing.assert_allclose(observation.payload_kg, stepped[:, 4], rtol=0, atol=1e-12)
