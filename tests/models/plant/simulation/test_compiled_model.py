"""The compiled run is the interpreted one, and its sensitivities are its derivatives."""

import numpy as np
import pytest

from firmware_py.errors import InputError
from models.plant.plant import read_plant
from models.plant.simulation.compiled_model import CompiledModel, model_inputs
from models.plant.simulation.sensitivity import sensitivity_model
from models.plant.step_model import names

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


@pytest.mark.parametrize(
    ("unit", "names_"),
    [
        ("twin", ["velocity_gain_1_a_s_rad", "root_stiffness_1_nm_rad", "creep_time_s"]),
        ("driven", ["link_mass_kg", "edge_gain", "hysteresis_yield_rad", "coulomb_friction_1_nm"]),
    ],
)
def test_sensitivities_are_the_derivatives_of_the_run(bench, unit, names_):
    model = read_plant().step_model(1, unit)
    u, plain = bench.inputs(model, 80), CompiledModel(model)
    y = CompiledModel(sensitivity_model(model, names_)).simulate(u, STEP_S)
    count = len(model.outputs)
    assert np.array_equal(y[:, :count], plain.simulate(u, STEP_S))
    for k, name in enumerate(names_):
        middle = model.parameter_values()[names(model.parameters).index(name)]
        ends = [
            plain.simulate(u, STEP_S, model.parameter_values({name: middle * (1 + side)}))
            for side in (1e-6, -1e-6)
        ]
        difference = (ends[0] - ends[1]) / (2e-6 * middle)
        slope = y[:, count * (k + 1) : count * (k + 2)]
        assert np.abs(slope).max() > 0
        assert np.allclose(slope, difference, atol=1e-4 * np.abs(slope).max()), name


def test_a_trial_without_an_input_of_the_plant_is_refused(synthetic):
    trial = synthetic(read_plant(), payload_kg=1.0, count=30)
    del trial.columns["goal_1_rad"]
    with pytest.raises(InputError, match="column goal_1_rad is missing"):
        model_inputs(read_plant().step_model(1, "twin"), trial)
