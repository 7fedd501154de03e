"""The sensitive run is the plain one, and its slopes are the derivatives of that run."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from models.gap.residuals.fit_parameters import plant_with_every_effect
from models.plant.plant import read_plant
from models.plant.simulation import sensitivity
from models.plant.simulation.runner import CompiledModel
from models.plant.simulation.sensitivity import SensitiveModel, write_sensitivity_c
from models.plant.step_model import names
from models.shared.c_compiler import OPTIONS_VARIABLE

STEP_S = 0.017

CHOSEN = {
    "twin": ["velocity_gain_1_a_s_rad", "root_stiffness_1_nm_rad", "creep_time_s"],
    "driven": ["link_mass_kg", "edge_gain", "hysteresis_yield_rad", "coulomb_friction_1_nm"],
    "observer": ["root_stiffness_1_nm_rad", "edge_gain"],
}


@pytest.mark.parametrize("unit", ["twin", "driven", "observer"])
def test_slopes_are_finite_differences_of_the_run(bench, unit):
    model = read_plant().step_model(1, unit)
    wrt = CHOSEN[unit]
    u, plain = bench.inputs(model, 80), CompiledModel(model)
    y, slopes = SensitiveModel(model, wrt).simulate(u, STEP_S)
    assert np.array_equal(y, plain.simulate(u, STEP_S))
    for k, name in enumerate(wrt):
        middle = model.parameter_values()[names(model.parameters).index(name)]
        step = 1e-6 * (abs(middle) or 1.0)
        ends = [
            plain.simulate(u, STEP_S, model.parameter_values({name: middle + side * step}))
            for side in (1, -1)
        ]
        difference = (ends[0] - ends[1]) / (2 * step)
        slope = slopes[:, :, k]
        assert np.abs(slope).max() > 0
        assert np.allclose(slope, difference, atol=1e-4 * np.abs(slope).max()), name


def test_what_is_constant_in_a_run_is_calculated_once(tmp_path):
    model = plant_with_every_effect(read_plant()).step_model(1, "twin")
    write_sensitivity_c(model, [], tmp_path)
    functions = (tmp_path / "sensitivity_step.c").read_text().split("\nvoid ")
    code = {own.split("(")[0]: own for own in functions if "{" in own.splitlines()[0]}
    # The peak of the friction near standstill is a power of parameters.
    assert "lanes_pow(" in code["sensitivity_constants"]
    assert "lanes_pow(" not in code["sensitivity_rate"]


def test_two_threads_never_build_casadi_functions_at_once(monkeypatch):
    model, building, at_once = read_plant().step_model(1, "observer"), [], []
    own = sensitivity.write_sensitivity_c

    def watched(*arguments):
        building.append(1)
        at_once.append(len(building))
        try:
            return own(*arguments)
        finally:
            building.pop()

    monkeypatch.setenv(OPTIONS_VARIABLE, "-O0")
    monkeypatch.setattr(sensitivity, "write_sensitivity_c", watched)
    monkeypatch.setattr(sensitivity, "_COMPILED", {})
    chosen = [CHOSEN["observer"][:1], CHOSEN["observer"]]
    with ThreadPoolExecutor(2) as pool:
        built = list(pool.map(lambda wrt: SensitiveModel(model, wrt), chosen))
    assert at_once == [1, 1]
    assert [len(b.wrt) for b in built] == [1, 2]


def rolled_out_jacobian(model, wrt, u, p):
    """Derivatives of the outputs by casadi's own jacobian of the unrolled run, by columns.

    The derivative of `finish` is zero where a state is zero; that of `smooth_finish` is not.
    """
    index = [names(model.parameters).index(name) for name in wrt]
    chosen = ca.MX.sym("chosen", len(index))
    q = ca.MX(p)
    q[index] = chosen
    x, rows = model.initial(u[0], q), []
    rows.append(model.output(x, u[0], q))
    for row in u:
        x = model.begin(x, row, q, STEP_S)
        for _ in range(model.substeps(STEP_S)):
            x = model.flow(x, row, q, STEP_S / model.substeps(STEP_S))
        x = model.smooth_finish(x, row, q, STEP_S)
        rows.append(model.output(x, row, q))
    whole = ca.Function("whole", [chosen], [ca.jacobian(ca.vertcat(*rows), chosen)])
    values = np.asarray(ca.DM(whole(p[index])))
    return values.reshape(len(rows), -1, len(wrt))


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("unit", ["twin", "driven", "observer"])
def test_slopes_are_those_of_the_unrolled_run(bench, dof, unit, monkeypatch):
    monkeypatch.setenv(OPTIONS_VARIABLE, "-O0")  # the run is short, and the same bits
    model = replace(read_plant().step_model(dof, unit), max_substep_s=STEP_S / 3)
    wrt, u, p = CHOSEN[unit], bench.inputs(model, 6), model.parameter_values()
    expected = rolled_out_jacobian(model, wrt, u, p)
    _, slopes = SensitiveModel(model, wrt).simulate(u, STEP_S)
    scale = np.abs(expected).max(axis=(0, 1))
    assert (scale > 0).all()
    assert (np.abs(slopes - expected) <= 1e-10 * scale).all()


def test_the_width_of_the_vectors_changes_no_bit(bench, monkeypatch):
    model = read_plant().step_model(1, "twin")
    u, runs = bench.inputs(model, 40), []
    for flags in sensitivity._vector_flags(), ():
        monkeypatch.setattr(sensitivity, "_vector_flags", lambda flags=flags: flags)
        runs.append(SensitiveModel(model, CHOSEN["twin"]).simulate(u, STEP_S))
    assert np.array_equal(runs[0][0], runs[1][0]) and np.array_equal(runs[0][1], runs[1][1])


@pytest.mark.parametrize("wrt", [[], ["current_bias_1_a"]])
def test_parameters_that_move_no_state_need_no_slope(bench, wrt):
    model = bench.plant("current_bias").step_model(1, "twin")
    u = bench.inputs(model, 10)
    y, slopes = SensitiveModel(model, wrt).simulate(u, STEP_S)
    assert slopes.shape == (*y.shape, len(wrt))
    current = names(model.outputs).index("current_1_a")
    assert (slopes[:, current] == 1).all() and (np.delete(slopes, current, axis=1) == 0).all()


def test_another_longest_substep_is_that_of_the_run(bench):
    model = read_plant().step_model(1, "twin")
    u = bench.inputs(model, 10)
    y, _ = SensitiveModel(model, [], 0.003).simulate(u, STEP_S)
    coarse = CompiledModel(replace(model, max_substep_s=0.003))
    assert np.array_equal(y, coarse.simulate(u, STEP_S))


def test_a_model_without_a_rate_is_refused():
    with pytest.raises(ValueError, match="has no rate"):
        SensitiveModel(replace(read_plant().step_model(1, "twin"), rate=None), [])


def test_slopes_that_are_not_wanted_are_zero_and_the_others_keep_their_bits(bench):
    model, wrt = read_plant().step_model(1, "twin"), CHOSEN["twin"]
    u, sensitive = bench.inputs(model, 40), SensitiveModel(model, wrt)
    y, every = sensitive.simulate(u, STEP_S)
    wanted = np.array([False, True, False])
    same, some = sensitive.simulate(u, STEP_S, wanted=wanted)
    assert np.array_equal(same, y)
    assert np.array_equal(some[..., wanted], every[..., wanted])
    assert (every[..., ~wanted] != 0).any() and (some[..., ~wanted] == 0).all()


@pytest.mark.parametrize("dof", [1, 2])
def test_a_run_in_lockstep_has_the_bits_of_a_run_of_its_own(bench, dof):
    model = bench.plant("cogging", "stribeck_friction", "creep").step_model(dof, "twin")
    wrt, plain = CHOSEN["twin"], CompiledModel(model)
    alone, several = SensitiveModel(model, wrt), SensitiveModel(model, wrt, lanes=4)
    p = np.tile(model.parameter_values(), (3, 1))
    p[1] *= 1.01
    p[2, names(model.parameters).index("cogging_1_nm")] = 0.2
    u = np.stack([scale * bench.inputs(model, 40) for scale in (1.0, 0.5, 0.8)])
    for count in 3, 1:
        y, slopes = several.simulate_several(u[:count], STEP_S, p[:count], u[:count, 0])
        for k in range(count):
            assert np.array_equal(y[k], plain.simulate(u[k], STEP_S, p[k]))
            assert np.array_equal(slopes[k], alone.simulate(u[k], STEP_S, p[k])[1])
    assert not np.array_equal(y[0], plain.simulate(u[0], STEP_S, p[2]))


def test_more_trials_than_lanes_are_refused(bench):
    model = read_plant().step_model(1, "twin")
    u, p = np.stack([bench.inputs(model, 5)] * 2), model.parameter_values()
    with pytest.raises(ValueError, match="2 trials in 1 lanes"):
        SensitiveModel(model, []).simulate_several(u, STEP_S, np.stack([p, p]), u[:, 0])
