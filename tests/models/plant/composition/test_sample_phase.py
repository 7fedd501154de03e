"""The sampled current keeps to the current limit, and the motion does not know of the sample."""

import numpy as np
import pytest

from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

PHASES = {"current_phase_1": 0.25, "goal_delay_1_s": 0.005}
LIMIT_A = 10.0


@pytest.fixture(scope="module")
def twin():
    return CompiledModel(read_plant().step_model(1, "twin"))


def run(twin, goal_rad, step_s=0.017, **changes):
    known = {"goal_1_rad": goal_rad, "payload_kg": np.ones(len(goal_rad))}
    u = np.column_stack([known[name] for name in names(twin.model.inputs)])
    y = twin.simulate(u, step_s, twin.model.parameter_values(PHASES | changes))
    return dict(zip(names(twin.model.outputs), y.T, strict=True))


def step(size_rad, count=60):
    return np.where(np.arange(count) < 6, 0.0, size_rad)


@pytest.mark.parametrize("size_rad", [0.3, 1.0, -1.0])
@pytest.mark.parametrize("step_s", [0.017, 0.001])
@pytest.mark.parametrize("limit_a", [LIMIT_A, 2.3])
def test_no_sample_exceeds_the_limit(twin, size_rad, step_s, limit_a):
    found = run(twin, step(size_rad), step_s, current_limit_1_a=limit_a)["current_1_a"]
    assert np.abs(found).max() == limit_a


def test_a_sensor_shows_the_limit_with_its_errors_behind_its_low_pass_too():
    plant = read_plant().with_effects("current_bias", "current_scale", "sensor_lag")
    twin = CompiledModel(plant.step_model(1, "twin"))
    errors = {"current_bias_1_a": 0.3, "current_scale_1": 0.1}
    goal_rad = step(1.0, 200)
    assert run(twin, goal_rad, **errors)["current_1_a"].max() == 1.1 * LIMIT_A + 0.3
    lagged = run(twin, goal_rad, **errors, sensor_lag_1_s=0.01)["current_1_a"]
    assert 0.5 * LIMIT_A < lagged.max() <= 1.1 * LIMIT_A + 0.3


def test_the_limit_changes_no_sample_below_it_and_no_motion(twin):
    goal_rad = 0.5 * np.sin(1.5 * 0.017 * np.arange(200))
    limited, free = (run(twin, goal_rad, current_limit_1_a=limit) for limit in (LIMIT_A, 50.0))
    assert np.abs(free["current_1_a"]).max() < LIMIT_A
    for name, values in free.items():
        assert np.array_equal(limited[name], values), name
    early, late = (run(twin, step(1.0), current_phase_1=phase) for phase in (0.3, 1.0))
    assert not np.array_equal(early["current_1_a"], late["current_1_a"])
    assert np.array_equal(early["angle_1_rad"], late["angle_1_rad"])
