"""Run of a plant from arrays: the same as that of a trial, and what it refuses."""

import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.motion import Motion
from firmware_py.signals import PERIOD_S
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, run_trial, simulate_plant
from models.plant.step_model import names
from models.trials.trial import Trial, TrialMeta

GOAL_RAD = Motion(period_s=1.5).table_rad()[:, 0]


def test_arrays_and_a_trial_give_the_same_run():
    plant = read_plant()
    run = simulate_plant(plant, {"goal_1_rad": GOAL_RAD, "payload_kg": 1.5})
    meta = TrialMeta(dof=1, payload_kg=1.5, trial=1, motion="sinusoid", source="test",
                     period_s=1.5, rest_samples=0)  # fmt: skip
    columns = {"time_s": PERIOD_S * np.arange(len(GOAL_RAD)), "goal_1_rad": GOAL_RAD}
    compiled = CompiledModel(plant.step_model(1, "twin"))
    y = run_trial(compiled, Trial("t", meta, columns))
    for k, name in enumerate(names(compiled.model.outputs)):
        np.testing.assert_array_equal(run[name], y[:, k])
    unloaded = simulate_plant(plant, {"goal_1_rad": GOAL_RAD})
    assert not unloaded["payload_kg"].any() and np.ptp(unloaded["di"]) < np.ptp(run["di"])
    np.testing.assert_array_equal(run["payload_kg"], np.full(len(GOAL_RAD), 1.5))
    assert all(len(column) == len(GOAL_RAD) for column in run.values())


WRONG = (
    ({"payload_kg": 1.0}, "goal_1_rad: is missing"),
    ({"goal_1_rad": GOAL_RAD, "payload_kg": 0.0, "angle_1_rad": 0.0}, "is no input"),
    ({"goal_1_rad": GOAL_RAD, "payload_kg": np.zeros(3)}, "payload_kg: has the shape"),
    ({"goal_1_rad": 0.1, "payload_kg": 0.0}, "give two rows or more"),
)


def test_inputs_that_do_not_fit_are_refused():
    plant = read_plant()
    for inputs, message in WRONG:
        with pytest.raises(InputError, match=message):
            simulate_plant(plant, inputs)
