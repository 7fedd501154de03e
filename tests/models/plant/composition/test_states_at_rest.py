"""States that decay at rest: they become zero and are never subnormal numbers."""

import casadi as ca
import numpy as np
import pytest

from models.plant.composition.parts import SMALLEST_STATE
from models.plant.plant import read_plant
from models.plant.step_model import names

STEP_S = 0.017
SMALLEST_NORMAL = np.finfo(np.float64).tiny


def _stages(model, x, u):
    """States after each function of one step."""
    p, count = model.parameter_values(), model.substeps(STEP_S)
    x = np.asarray(model.begin(x, u, p, STEP_S)).ravel()
    yield x
    for _ in range(count):
        x = np.asarray(model.flow(x, u, p, STEP_S / count)).ravel()
        yield x
    yield np.asarray(model.finish(x, u, p, STEP_S)).ravel()


def _subnormal(x):
    return (x != 0) & (np.abs(x) < SMALLEST_NORMAL)


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("unit", ["twin", "driven", "observer"])
def test_the_end_of_a_step_sets_every_state_to_zero_that_is_too_small(dof, unit):
    model = read_plant().step_model(dof, unit)
    p, u = model.parameter_values(), np.zeros(len(model.inputs))
    start = np.asarray(model.initial(u, p)).ravel()
    for size in (1e-31, 1e-300, 5e-324):
        after = np.asarray(model.finish(np.full(len(start), size), u, p, STEP_S)).ravel()
        assert not after[np.abs(after) < SMALLEST_STATE].any()
        assert not _subnormal(after).any()


def test_the_observer_at_rest_passes_no_subnormal_number():
    """Half a second of motion, then 6 s of zeros: after 5 s the filter's states were subnormal."""
    model = read_plant().step_model(1, "observer")
    u, p = np.zeros(len(model.inputs)), model.parameter_values()
    x = np.asarray(model.initial(u, p)).ravel()
    for k in range(30 + 360):
        u[:] = 0.3 * np.sin(0.02 * k) if k < 30 else 0.0
        for stage in _stages(model, x, u):
            assert not _subnormal(stage).any(), f"step {k}"
            x = stage
    at_rest = dict(zip(names(model.states), x, strict=True))
    for name in ("joint_1_rad", "joint_rate_1_rad_s", "ramp_rate_1_rad_s"):
        assert at_rest[name] == 0.0


def test_a_state_of_ordinary_size_keeps_its_bits_and_one_that_is_no_number_stays_none():
    model = read_plant().step_model(1, "twin")
    p, u = model.parameter_values(), np.zeros(len(model.inputs))
    x = np.random.default_rng(1).normal(size=len(model.states))
    after = np.asarray(model.finish(x, u, p, STEP_S)).ravel()
    np.testing.assert_array_equal(after, np.asarray(model.smooth_finish(x, u, p, STEP_S)).ravel())
    x[names(model.states).index("joint_rate_1_rad_s")] = np.nan
    assert np.isnan(np.asarray(model.finish(x, u, p, STEP_S))).any()


def test_a_state_of_zero_keeps_its_derivative():
    """A plant may be fitted from an effect of strength zero, whose states are all zero."""
    model = read_plant().step_model(1, "driven")
    x = ca.SX.sym("x", len(model.states))
    others = [np.zeros(len(model.inputs)), model.parameter_values(), STEP_S]
    slope = ca.Function("slope", [x], [ca.jacobian(model.smooth_finish(x, *others), x)])
    bend = names(model.states).index("root_bend_1_rad")
    assert np.asarray(slope(np.zeros(len(model.states))))[bend, bend] == 1.0
