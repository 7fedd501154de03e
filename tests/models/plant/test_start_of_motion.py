"""Start of a trial that begins in motion: its rate, and a simulation that goes on from it."""

import numpy as np
import pytest

from models.plant.plant import NOMINAL, read_plant
from models.plant.simulation.runner import (
    CompiledModel,
    run_trial,
    start_of_motion,
    trial_parameters,
)
from models.trials.files import read_trials

EXAMPLES = NOMINAL.parent / "examples"
STEP_S = 0.001


@pytest.fixture
def trial_of(tmp_path):
    """Trial of the EMPS with a given position and command."""

    def make(position_m, command_v):
        rows = np.column_stack([np.arange(len(position_m)) * STEP_S, command_v, position_m])
        head = "time_s,command_1_v,position_1_m"
        np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=head, comments="", fmt="%.12g")
        meta = ["schema = 1", "dof = 1", "payload_kg = 0.0", "trial = 1", 'motion = "test"',
                'source = "measured"', "period_s = 1.0", "rest_samples = 1"]  # fmt: skip
        (tmp_path / "run.toml").write_text("\n".join(meta))
        return read_trials(tmp_path, read_plant(EXAMPLES / "emps.toml").signals).trials[0]

    return make


@pytest.mark.parametrize("jerk_m_s3", [0.0, 30.0, -60.0])
def test_the_start_rate_follows_a_jerk_where_there_is_little_noise(trial_of, jerk_m_s3):
    """A parabola over 50 ms would be wrong by jerk · (50 ms)² / 10 and more: 15 mm/s."""
    time_s, rng = np.arange(400) * STEP_S, np.random.default_rng(1)
    position_m = 0.1 + 0.04 * time_s + 0.5 * time_s**2 + jerk_m_s3 / 6 * time_s**3
    noisy = position_m + 1e-7 * rng.standard_normal(len(time_s))
    value, rate = start_of_motion(trial_of(noisy, 0 * time_s), "position_1_m")
    assert value == pytest.approx(0.1, abs=1e-6)
    assert rate == pytest.approx(0.04, abs=5e-4)


def test_the_start_rate_averages_noise(trial_of):
    time_s, rng = np.arange(400) * STEP_S, np.random.default_rng(2)
    noisy = 0.04 * time_s + 2e-5 * rng.standard_normal(len(time_s))
    rate = start_of_motion(trial_of(noisy, 0 * time_s), "position_1_m")[1]
    assert rate == pytest.approx(0.04, abs=0.012)  # two standard errors over 50 ms: 3 mm/s


def test_a_part_of_a_recording_that_begins_in_motion_is_simulated_like_the_whole(trial_of):
    time_s = np.arange(3000) * STEP_S
    command_v = 2 * np.sin(4 * time_s)
    plant = read_plant(EXAMPLES / "emps.toml")
    model = plant.step_model(1)
    u = np.column_stack([command_v, 0 * command_v])
    position_m = model.simulate(u[:-1], STEP_S)[:, 0]
    part = trial_of(position_m[700:], command_v[700:])
    simulated = run_trial(CompiledModel(model), part, trial_parameters(model, part))[:, 0]
    assert np.abs(np.diff(position_m)).max() > 1e-4
    assert np.allclose(simulated, position_m[700:], atol=2e-4)
