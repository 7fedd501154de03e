"""Every effect of the catalogue in an FMU: its strength is a parameter that can be tuned."""

import numpy as np
import pytest

from firmware_py.core.signals import PERIOD_S
from fmu.fmpy_instance import FmuArchive
from fmu.fmu_builder import build_fmu
from models.plant.plant import read_plant
from models.plant.step_model import names


@pytest.fixture(scope="module")
def full():
    """The nominal plant with every effect that it can have."""
    plant = read_plant()
    return plant.with_effects(*plant.applicable())


@pytest.fixture(scope="module")
def full_archive(full, tmp_path_factory):
    path = tmp_path_factory.mktemp("full") / "full.fmu"
    with FmuArchive(build_fmu(full.step_model(1), path, fmi=3)) as archive:
        yield archive


def strengths(plant):
    found = {effect: plant.strengths(effect, 1) for effect in plant.applicable()}
    assert len(found) >= 30
    return [f"parameters.{name}" for group in found.values() for name in group]


def test_a_tuned_strength_acts_as_in_the_plant_and_a_reset_takes_it_back(full, full_archive):
    """One run of the FMU for a study: set, run, reset; parity with the interpreted model."""
    model = full.step_model(1)
    u = np.column_stack([0.4 * np.sin(0.3 * np.arange(12)), np.full(12, 1.0)])
    changes = {"backlash_1_rad": 0.01, "dead_time_1_s": 0.02}
    with full_archive.instance() as instance:
        steps_s = np.full(len(u), PERIOD_S)
        plain = instance.run(names(model.inputs), u, steps_s, names(model.outputs))
        instance.fmu.reset()
        instance.set({f"parameters.{name}": value for name, value in changes.items()})
        tuned = instance.run(names(model.inputs), u, steps_s, names(model.outputs))
        instance.fmu.reset()
        again = instance.run(names(model.inputs), u, steps_s, names(model.outputs))
    expected = model.simulate(u, PERIOD_S, model.parameter_values(changes))
    np.testing.assert_allclose(tuned, expected, rtol=0, atol=1e-9)
    assert np.abs(tuned - plain).max() > 1e-4
    np.testing.assert_array_equal(again, plain)


def test_each_strength_is_tunable_and_has_a_finite_derivative(full, full_archive):
    model = full.step_model(1)
    variables = {v.name: v for v in full_archive.description.modelVariables}
    assert {variables[name].variability for name in strengths(full)} == {"tunable"}
    table = {name: v.valueReference for name, v in variables.items()}
    rates = [r for name, r in table.items() if name.startswith("der(")]
    unknowns = [*(table[name] for name in names(model.outputs)), *rates]
    with full_archive.instance() as instance:
        instance.initialize({"payload_kg": 1.0, "goal_1_rad": 0.2})
        for k in range(4):
            instance.set({"goal_1_rad": 0.2 + 0.02 * k})
            instance.step(PERIOD_S)
        acting = 0
        for name in strengths(full):
            slope = instance.fmu.getDirectionalDerivative(unknowns, [table[name]], [1.0])
            assert np.isfinite(slope).all()
            acting += bool(np.any(slope))
    # a limit that is not reached has no slope; some effects show in states of their own only
    assert acting >= len(strengths(full)) - 3
