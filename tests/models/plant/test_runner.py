"""Compiled runs are the interpreted ones, and slopes are the derivatives of the run."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S
from models.plant.plant import NOMINAL, read_plant
from models.plant.simulation import runner
from models.plant.simulation.model_c import write_run_c
from models.plant.simulation.runner import (
    CompiledModel,
    model_inputs,
    run_trial,
    simulate_plant,
    start_of_motion,
)
from models.plant.step_model import names
from models.shared.c_compiler import OPTIONS_VARIABLE
from models.trials.files import read_trials
from models.trials.trial import Trial, TrialMeta

STEP_S = 0.017


UNITS = pytest.mark.parametrize(("dof", "unit"), [(1, "twin"), (2, "driven"), (1, "observer")])


@UNITS
def test_the_compiled_run_is_the_interpreted_one(bench, dof, unit):
    model = read_plant().step_model(dof, unit)
    u = bench.inputs(model, 60)
    assert np.array_equal(CompiledModel(model).simulate(u, STEP_S), model.simulate(u, STEP_S))


CHOSEN = {
    "twin": ["velocity_gain_1_a_s_rad", "root_stiffness_1_nm_rad", "creep_time_s"],
    "driven": ["link_mass_kg", "edge_gain", "hysteresis_yield_rad", "coulomb_friction_1_nm"],
    "observer": ["root_stiffness_1_nm_rad", "edge_gain"],
}


@pytest.mark.slow
def test_two_threads_never_build_casadi_functions_at_once(monkeypatch):
    model, building, at_once = read_plant().step_model(1, "observer"), [], []

    def watched(*arguments):
        building.append(1)
        at_once.append(len(building))
        try:
            return write_run_c(*arguments)
        finally:
            building.pop()

    monkeypatch.setenv(OPTIONS_VARIABLE, "-O0")
    monkeypatch.setattr(runner, "write_run_c", watched)
    monkeypatch.setattr(runner, "_COMPILED", {})
    chosen = [CHOSEN["observer"][:1], CHOSEN["observer"]]
    with ThreadPoolExecutor(2) as pool:
        built = list(pool.map(lambda wrt: CompiledModel(model, wrt), chosen))
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


@pytest.mark.slow
@UNITS
def test_slopes_are_those_of_the_unrolled_run(bench, dof, unit, monkeypatch):
    monkeypatch.setenv(OPTIONS_VARIABLE, "-O0")  # the run is short, and the same bits
    model = replace(read_plant().step_model(dof, unit), max_substep_s=STEP_S / 3)
    wrt, u, p = CHOSEN[unit], bench.inputs(model, 6), model.parameter_values()
    expected = rolled_out_jacobian(model, wrt, u, p)
    compiled = CompiledModel(model, wrt)
    y, slopes = compiled.derivatives(u, STEP_S)
    assert np.array_equal(y, compiled.simulate(u, STEP_S))
    scale = np.abs(expected).max(axis=(0, 1))
    assert (scale > 0).all()
    assert (np.abs(slopes - expected) <= 1e-10 * scale).all()


@pytest.mark.parametrize("wrt", [[], ["current_bias_1_a"]])
def test_parameters_that_move_no_state_need_no_slope(bench, wrt):
    model = read_plant().with_effects("current_bias").step_model(1, "twin")
    u = bench.inputs(model, 10)
    y, slopes = CompiledModel(model, wrt).derivatives(u, STEP_S)
    assert slopes.shape == (*y.shape, len(wrt))
    current = names(model.outputs).index("current_1_a")
    assert (slopes[:, current] == 1).all() and (np.delete(slopes, current, axis=1) == 0).all()


def test_slopes_that_are_not_wanted_are_zero_and_change_no_other(bench):
    model, wrt = read_plant().step_model(1, "twin"), CHOSEN["twin"]
    u, sensitive = bench.inputs(model, 40), CompiledModel(model, wrt)
    y, every = sensitive.derivatives(u, STEP_S)
    wanted = np.array([False, True, False])
    same, some = sensitive.derivatives(u, STEP_S, wanted=wanted)
    assert np.array_equal(same, y)
    assert np.array_equal(some[..., wanted], every[..., wanted])
    assert (every[..., ~wanted] != 0).any() and (some[..., ~wanted] == 0).all()


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


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({"payload_kg": 1.0}, "goal_1_rad: is missing"),
        ({"goal_1_rad": GOAL_RAD, "payload_kg": 0.0, "angle_1_rad": 0.0}, "is no input"),
        ({"goal_1_rad": GOAL_RAD, "payload_kg": np.zeros(3)}, "payload_kg: has the shape"),
        ({"goal_1_rad": 0.1, "payload_kg": 0.0}, "give two rows or more"),
    ],
)
def test_inputs_that_do_not_fit_are_refused(inputs, message):
    with pytest.raises(InputError, match=message):
        simulate_plant(read_plant(), inputs)


def test_a_trial_without_an_input_of_the_plant_is_refused(synthetic):
    trial = synthetic(read_plant(), payload_kg=1.0, count=30)
    del trial.columns["goal_1_rad"]
    with pytest.raises(InputError, match="column goal_1_rad is missing"):
        model_inputs(read_plant().step_model(1, "twin"), trial)


EXAMPLES = NOMINAL.parent / "examples"


@pytest.fixture
def trial_of(tmp_path):
    """Trial of the EMPS with these positions and commands, at 1 kHz."""

    def make(position_m, command_v):
        rows = np.column_stack([np.arange(len(position_m)) * 1e-3, command_v, position_m])
        head = "time_s,command_1_v,position_1_m"
        np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=head, comments="", fmt="%.12g")
        meta = ["schema = 1", "dof = 1", "payload_kg = 0.0", "trial = 1", 'motion = "test"',
                'source = "measured"', "period_s = 1.0", "rest_samples = 1"]  # fmt: skip
        (tmp_path / "run.toml").write_text("\n".join(meta))
        return read_trials(tmp_path, read_plant(EXAMPLES / "emps.toml").signals).trials[0]

    return make


@pytest.mark.parametrize(
    ("jerk_m_s3", "noise_m", "tolerance_m_s"),
    # A parabola over 50 ms would be wrong by jerk · (50 ms)² / 10 and more: 15 mm/s; the standard
    # error of the rate over 50 ms with a noise of 20 µm is 6 mm/s.
    [(0.0, 1e-7, 5e-4), (-60.0, 1e-7, 5e-4), (0.0, 2e-5, 0.012)],
)
def test_the_start_rate_follows_a_jerk_and_averages_noise(
    trial_of, jerk_m_s3, noise_m, tolerance_m_s
):
    time_s, rng = np.arange(400) * 1e-3, np.random.default_rng(2)
    position_m = 0.1 + 0.04 * time_s + 0.5 * time_s**2 + jerk_m_s3 / 6 * time_s**3
    noisy = position_m + noise_m * rng.standard_normal(len(time_s))
    value, rate = start_of_motion(trial_of(noisy, 0 * time_s), "position_1_m")
    assert value == pytest.approx(0.1, abs=10 * noise_m)
    assert rate == pytest.approx(0.04, abs=tolerance_m_s)


def test_a_part_of_a_recording_that_begins_in_motion_is_simulated_like_the_whole(trial_of):
    command_v = 2 * np.sin(4e-3 * np.arange(3000))
    model = read_plant(EXAMPLES / "emps.toml").step_model(1)
    u = np.column_stack([command_v, 0 * command_v])
    position_m = model.simulate(u[:-1], 1e-3)[:, 0]
    simulated = run_trial(CompiledModel(model), trial_of(position_m[700:], command_v[700:]))[:, 0]
    assert np.abs(np.diff(position_m)).max() > 1e-4
    assert np.allclose(simulated, position_m[700:], atol=2e-4)
