"""Observer FMU on angles that no motion leads to: cold starts, jumps, hostile samples."""

import numpy as np
import pytest

from firmware_py.core.signals import PERIOD_S
from firmware_py.inference.fmu_instance import FmuInstance
from fmu.fmu_builder import build_fmu
from models.plant.plant import read_plant
from models.plant.step_model import names

OUTPUTS = ["di", "tip_x_m", "tip_y_m", "tip_z_m", "payload_kg"]


@pytest.fixture(scope="module", params=[1, 2], ids=["1dof", "2dof"])
def observer(request, tmp_path_factory):
    """The FMU, with its number of joints and its interpreted model."""
    model = read_plant().step_model(request.param, "observer")
    path = build_fmu(model, tmp_path_factory.mktemp("observer") / "observer.fmu")
    with FmuInstance(path) as fmu:
        yield fmu, request.param, model


def _take(fmu, dof, angle_rad, current_a=0.0, step_s=PERIOD_S):
    joints = range(1, dof + 1)
    sample = [f"angle_{j}_rad" for j in joints] + [f"current_{j}_a" for j in joints]
    fmu.set(sample, [angle_rad] * dof + [current_a] * dof)
    fmu.step(step_s)
    return fmu.get(OUTPUTS)


@pytest.mark.parametrize("angle_rad", [0.5, 4.0, -5.0, 1e3, 1e308])
def test_a_cold_start_far_from_zero_is_the_warm_start_there(observer, angle_rad):
    """The inputs are not set before initialization: the first sample comes with the first step."""
    fmu, dof, _ = observer
    fmu.reset()
    fmu.start()
    cold = np.array([_take(fmu, dof, angle_rad) for _ in range(50)])
    fmu.reset()
    fmu.set([f"angle_{j}_rad" for j in range(1, dof + 1)], [angle_rad] * dof)
    fmu.start()
    warm = np.array([_take(fmu, dof, angle_rad) for _ in range(50)])
    np.testing.assert_allclose(cold, warm, atol=1e-9, rtol=0)
    assert np.ptp(cold[:, -1]) == 0.0  # at rest nothing is learnt of the payload


def test_a_jump_keeps_the_payload_and_rests_at_the_sample(observer):
    fmu, dof, _ = observer
    fmu.reset()
    for k in range(120):
        current_a = 3.0 * np.sign(np.cos(0.05 * k))
        before = _take(fmu, dof, 0.3 * np.sin(0.05 * k), current_a)
    assert before[-1] != 1.0  # the prior: something was learnt
    after = [_take(fmu, dof, -0.5) for _ in range(3)]
    assert {row[-1] for row in after} == {before[-1]}
    np.testing.assert_allclose(after[2], after[0], atol=1e-3, rtol=0)


@pytest.mark.parametrize("step_s", [1e-3, PERIOD_S, 0.5])
def test_samples_at_random_are_never_refused(observer, step_s):
    """Jumps below and above what counts as one; the outputs are always finite numbers."""
    fmu, dof, _ = observer
    fmu.reset()
    random = np.random.default_rng(3)
    for k in range(150):
        size = (0.08, 1.0, 10.0)[k % 3] if k > 75 else 0.08
        row = _take(fmu, dof, size * random.choice([-1, 1]), random.normal() * 100, step_s)
        assert np.isfinite(row).all()
    for _ in range(20):
        row = _take(fmu, dof, 0.1)
    assert np.isfinite(row).all()


def test_the_fmu_restarts_like_the_interpreted_model(observer):
    fmu, dof, model = observer
    steps = np.array([0.0, 0.1, 4.0, 4.0, 4.1, 0.0, 0.05])
    u = np.column_stack([steps] * dof + [np.full(len(steps), 0.5)] * dof)
    rows = [names(model.outputs).index(name) for name in OUTPUTS]
    expected = model.simulate(u, PERIOD_S)[1:, rows]
    fmu.reset()
    found = [_take(fmu, dof, angle_rad, 0.5) for angle_rad in steps]
    np.testing.assert_allclose(found, expected, atol=1e-9, rtol=0)


def test_a_state_that_no_link_can_have_begins_anew(observer):
    _, _, model = observer
    u, p = np.full(len(model.inputs), 0.4), model.parameter_values()
    start = np.asarray(model.initial(u, p)).ravel()
    bend = names(model.states).index("root_bend_1_rad")
    for value in (4.0, -4.0, np.nan, np.inf, 1e200):
        damaged = start.copy()
        damaged[bend] = value
        after = np.asarray(model.finish(damaged, u, p, PERIOD_S)).ravel()
        np.testing.assert_array_equal(after, start)
