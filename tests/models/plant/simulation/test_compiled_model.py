"""The compiled run is the interpreted one."""

import numpy as np
import pytest

from firmware_py.errors import InputError
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, model_inputs

STEP_S = 0.017


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("unit", ["twin", "driven", "observer"])
def test_the_compiled_run_is_the_interpreted_one(bench, dof, unit):
    model = read_plant().step_model(dof, unit)
    u = bench.inputs(model, 60)
    assert np.array_equal(CompiledModel(model).simulate(u, STEP_S), model.simulate(u, STEP_S))


def test_a_run_goes_on_where_another_stopped(bench):
    model = read_plant().step_model(1, "twin")
    u, p = bench.inputs(model, 40), model.parameter_values()
    x = np.asarray(model.initial(u[0], p)).ravel()
    for row in u[:20]:
        x = model.advance(x, row, p, STEP_S)
    compiled = CompiledModel(model)
    whole = compiled.simulate(u, STEP_S)
    assert np.array_equal(compiled.simulate(u[20:], STEP_S, p, x)[1:], whole[21:])


def test_the_step_length_does_not_change_the_motion(bench):
    """But for the staircase of the goals, which is the step's: here the goal stands still."""
    model = read_plant().step_model(1, "twin")
    compiled = CompiledModel(model)
    x = compiled.start(np.array([0.0, 1.0]), model.parameter_values())
    coarse, fine = (
        compiled.simulate(np.tile([0.3, 1.0], (count, 1)), step_s, x=x)
        for count, step_s in ((30, 0.034), (120, 0.0085))
    )
    assert np.allclose(coarse, fine[::4], rtol=0, atol=2e-3)


def test_a_trial_without_an_input_of_the_plant_is_refused(synthetic):
    trial = synthetic(read_plant(), payload_kg=1.0, count=30)
    del trial.columns["goal_1_rad"]
    with pytest.raises(InputError, match="column goal_1_rad is missing"):
        model_inputs(read_plant().step_model(1, "twin"), trial)
