"""Other loads and drives through the same seams, against textbook solutions."""

import numpy as np
import pytest
from scipy.special import ellipk

from firmware_py.errors import InputError
from models.plant.plant import read_plant
from models.plant.step import names

PENDULUM = {
    "mass_kg": 0.5, "arm_mass_kg": 0.2, "arm_length_m": 0.3, "rotor_inertia_1_kg_m2": 1e-4,
    "torque_constant_1_nm_a": 0.01, "winding_resistance_1_ohm": 50.0, "duty_gain_1": 0.01,
}  # fmt: skip


@pytest.fixture
def plant_of(tmp_path):
    def make(drive, load, parameters, effects=()):
        path = tmp_path / f"{load}.toml"
        rows = "\n".join(f"{name} = {value}" for name, value in parameters.items())
        listed = ", ".join(f'{{ name = "{name}" }}' for name in effects)
        path.write_text(
            f'schema = 1\nname = "test"\ndrive = {{ kind = "{drive}" }}\n'
            f'load = {{ kind = "{load}" }}\neffects = [{listed}]\n[parameters]\n{rows}\n'
        )
        return read_plant(path)

    return make


@pytest.mark.parametrize("amplitude_rad", [0.02, 1.0, 2.0])
def test_a_pendulum_swings_with_the_period_of_the_elliptic_integral(plant_of, amplitude_rad):
    plant = plant_of("duty", "pendulum", PENDULUM)
    model = plant.step_model(1)
    x = np.zeros(len(model.states))
    x[names(model.states).index("joint_1_rad")] = amplitude_rad
    step_s, payload_kg, angles = 5e-3, 0.3, []
    for _ in range(400):
        x = model.advance(
            x, np.array([0.0, 0.0, 1.0, payload_kg]), model.parameter_values(), step_s
        )
        angles.append(x[names(model.states).index("joint_1_rad")])
    angles = np.array(angles)
    down = np.flatnonzero((angles[:-1] > 0) & (angles[1:] <= 0))
    crossings = (down + 1 + angles[down] / (angles[down] - angles[down + 1])) * step_s
    q, length = PENDULUM, PENDULUM["arm_length_m"]
    inertia = (q["mass_kg"] + payload_kg + q["arm_mass_kg"] / 3) * length**2 + 1e-4
    moment = (q["mass_kg"] + payload_kg + q["arm_mass_kg"] / 2) * 9.81 * length
    expected = 4 * np.sqrt(inertia / moment) * ellipk(np.sin(amplitude_rad / 2) ** 2)
    assert np.diff(crossings) == pytest.approx(expected, rel=2e-3)


def test_a_motor_holds_the_pendulum_where_torque_and_gravity_agree(plant_of):
    changes = PENDULUM | {"duty_gain_1": 2.0, "torque_constant_1_nm_a": 0.4,
                          "winding_resistance_1_ohm": 2.0}  # fmt: skip
    plant = plant_of("duty", "pendulum", changes, ["viscous_friction"])
    model = plant.step_model(1)
    p = model.parameter_values({"viscous_friction_1_nm_s_rad": 0.5})
    u = np.tile([1.0, 6.0, 1.0, 0.0], (800, 1))
    angle, current = model.simulate(u, 0.01, p)[-1, :2]
    gravity = (0.5 + 0.1) * 9.81 * 0.3 * np.sin(angle)
    assert 0.4 * current == pytest.approx(gravity, rel=1e-4)
    assert current == pytest.approx(2.0 * (1.0 - angle) * 6.0 / 2.0, rel=1e-6)


def test_a_mass_under_a_constant_force_moves_by_half_a_t_squared(plant_of):
    plant = plant_of("force", "mass", {"mass_kg": 95.0, "force_constant_1_n_v": 35.0})
    model = plant.step_model(1)
    assert names(model.inputs) == ["command_1_v", "payload_kg"]
    y = model.simulate(np.tile([0.5, 5.0], (100, 1)), 0.01)
    time_s = 0.01 * np.arange(101)
    assert y[:, 0] == pytest.approx(0.5 * 35.0 * 0.5 / 100.0 * time_s**2, abs=1e-9)


def test_a_mass_against_friction_reaches_its_final_speed(plant_of):
    plant = plant_of("force", "mass", {"mass_kg": 95.0, "viscous_friction_1_n_s_m": 20.0},
                     ["viscous_friction"])  # fmt: skip
    model = plant.step_model(1)
    y = model.simulate(np.tile([1.0, 0.0], (500, 1)), 0.1)[:, 0]
    assert (y[-1] - y[-2]) / 0.1 == pytest.approx(35.1507 / 20.0, rel=1e-3)


def test_what_a_load_cannot_do_is_refused(plant_of):
    plant = plant_of("duty", "pendulum", PENDULUM)
    with pytest.raises(InputError, match="2 joints for load 'pendulum'"):
        plant.step_model(2)
    with pytest.raises(InputError, match="no observer unit for a pendulum on a duty drive"):
        plant.step_model(1, "observer")
