"""Twin and driven link as composed: sampled current, states at rest, a driven link is the twin."""

import numpy as np
import pytest

from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

STEP_S, PERIOD_S, REST, COUNT = 0.017, 4.352, 60, 572
TORQUE_CONSTANT_NM_A = 6.83


OPTIONS = {
    "velocity_feedforward_1": 0.8, "position_integral_1_per_s2": 4.0, "setpoint_weight_1": 0.7,
}  # fmt: skip


@pytest.mark.parametrize("interpolation, phase, options", [(1.0, 0.5, {}), (0.0, 0.5, OPTIONS)])
def test_the_current_of_a_motion_has_the_inertia_of_rotor_and_link(interpolation, phase, options):
    """Inertia and weight are in phase with the angle: 10 N·m/rad of them without payload.

    A rotor that is ignored would be missed by J ω² = 1.8 N·m/rad, and taken for a link that is
    0.3 kg heavier.
    """
    plant = read_plant().with_values(
        {"goal_interpolation_1": interpolation, "current_phase_1": phase} | options
    )
    moving_s = STEP_S * np.maximum(np.arange(COUNT) - REST, 0)
    goal = -0.52 * np.sin(2 * np.pi / PERIOD_S * moving_s)
    twin, driven = (CompiledModel(plant.step_model(1, kind)) for kind in ("twin", "driven"))
    assert names(twin.model.outputs)[:2] == ["angle_1_rad", "current_1_a"]
    angle, current = twin.simulate(np.column_stack([goal, 0 * goal]), STEP_S)[:, :2].T
    u = np.column_stack([angle, 0 * angle])
    p = np.array(driven.model.parameter_values())
    y = driven.simulate(u[1:], STEP_S, p, driven.start(u[0], p))
    error_nm = TORQUE_CONSTANT_NM_A * (
        y[:, names(driven.model.outputs).index("current_1_a")] - current
    )
    rate = np.gradient(angle, STEP_S)
    moving = (np.arange(len(angle)) > REST) & (np.abs(rate) > 0.15)  # dry friction apart
    columns = np.column_stack([angle, rate, np.sign(rate), np.ones(len(angle))])
    per_rad, per_rate, *_ = np.linalg.lstsq(columns[moving], error_nm[moving], rcond=None)[0]
    assert abs(per_rad) < 0.25
    assert abs(per_rate) < 0.25


PHASES = {"current_phase_1": 0.25, "goal_delay_1_s": 0.005}
LIMIT_A = 10.0


def run(bench, goal_rad, step_s=STEP_S, **changes):
    return bench.run(PHASES | changes, goal=goal_rad, step_s=step_s)


def step(size_rad, count=60):
    return np.where(np.arange(count) < 6, 0.0, size_rad)


@pytest.mark.parametrize(
    ("size_rad", "step_s", "limit_a"), [(1.0, 0.017, LIMIT_A), (-1.0, 0.001, 2.3)]
)
def test_no_sample_exceeds_the_limit(bench, size_rad, step_s, limit_a):
    current_a = run(bench, step(size_rad), step_s, current_limit_1_a=limit_a)["current_1_a"]
    assert np.abs(current_a).max() == limit_a


def test_a_sensor_shows_the_limit_with_its_errors_behind_its_low_pass_too(bench):
    errors = {"current_bias_1_a": 0.3, "current_scale_1": 0.1}
    goal_rad = step(1.0, 200)
    assert run(bench, goal_rad, **errors)["current_1_a"].max() == 1.1 * LIMIT_A + 0.3
    lagged = run(bench, goal_rad, **errors, sensor_lag_1_s=0.01)["current_1_a"]
    assert 0.5 * LIMIT_A < lagged.max() <= 1.1 * LIMIT_A + 0.3


def test_the_limit_changes_no_sample_below_it_and_no_motion(bench):
    goal_rad = 0.5 * np.sin(1.5 * 0.017 * np.arange(200))
    limited, free = (run(bench, goal_rad, current_limit_1_a=limit) for limit in (LIMIT_A, 50.0))
    assert np.abs(free["current_1_a"]).max() < LIMIT_A
    for name, values in free.items():
        assert np.array_equal(limited[name], values), name
    early, late = (run(bench, step(1.0), current_phase_1=phase) for phase in (0.3, 1.0))
    assert not np.array_equal(early["current_1_a"], late["current_1_a"])
    assert np.array_equal(early["angle_1_rad"], late["angle_1_rad"])


def _is_subnormal(x):
    return (x != 0) & (np.abs(x) < np.finfo(np.float64).tiny)


def test_the_observer_at_rest_passes_no_subnormal_number():
    """Half a second of motion, then 6 s of zeros: after 5 s the filter's states were subnormal."""
    model = read_plant().step_model(1, "observer")
    u, p, count = np.zeros(len(model.inputs)), model.parameter_values(), model.substeps(STEP_S)
    x = np.asarray(model.initial(u, p)).ravel()
    for k in range(30 + 360):
        u[:] = 0.3 * np.sin(0.02 * k) if k < 30 else 0.0
        stages = [np.asarray(model.begin(x, u, p, STEP_S)).ravel()]
        for _ in range(count):
            stages.append(np.asarray(model.flow(stages[-1], u, p, STEP_S / count)).ravel())
        x = np.asarray(model.finish(stages[-1], u, p, STEP_S)).ravel()
        assert not _is_subnormal(np.array([*stages, x])).any(), f"step {k}"
    at_rest = dict(zip(names(model.states), x, strict=True))
    for name in ("joint_1_rad", "joint_rate_1_rad_s", "ramp_rate_1_rad_s"):
        assert at_rest[name] == 0.0
