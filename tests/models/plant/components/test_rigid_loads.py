"""Other loads and drives through the same seams, against textbook solutions."""

import json

import msgspec
import numpy as np
import pytest
from scipy.special import ellipk

from firmware_py.errors import InputError
from models.gap.residuals.fit_parameters import effect_fit_parameters
from models.plant.plant import read_plant
from models.plant.step_model import names

PENDULUM = {
    "mass_kg": 0.5, "arm_mass_kg": 0.2, "arm_length_m": 0.3, "rotor_inertia_1_kg_m2": 1e-4,
    "torque_constant_1_nm_a": 0.01, "winding_resistance_1_ohm": 50.0, "duty_gain_1": 0.01,
    "current_limit_1_a": 3.0,
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
    parameters = {"mass_kg": 95.0, "force_constant_1_n_v": 35.0, "viscous_friction_1_n_s_m": 20.0}
    plant = plant_of("force", "mass", parameters, ["viscous_friction"])
    model = plant.step_model(1)
    y = model.simulate(np.tile([1.0, 0.0], (500, 1)), 0.1)[:, 0]
    assert (y[-1] - y[-2]) / 0.1 == pytest.approx(35.0 / 20.0, rel=1e-3)


def test_a_constant_of_the_machine_has_no_default(plant_of):
    said = r"mass\.toml: .*force_constant_1_n_v .*no default; .*N/V under \[parameters\]"
    with pytest.raises(InputError, match=said):
        plant_of("force", "mass", {"mass_kg": 80.0})


@pytest.mark.parametrize(
    ("drive", "load", "own"),
    [
        ("duty", "pendulum", "duty_gain_1 mass_kg arm_length_m"),
        ("cascade", "pendulum", "mass_kg arm_length_m"),
        ("current", "flexible_link", "torque_constant_1_nm_a link_inertia_kg_m2"),
        ("force", "flexible_link", "force_constant_1_nm_v link_inertia_kg_m2"),
        ("measured", "mass", "mass_kg"),
    ],
)
def test_every_part_wants_its_own_constants_and_nothing_else(plant_of, drive, load, own):
    given = dict.fromkeys(own.split(), 2.0)
    assert plant_of(drive, load, given).parameters.keys() >= given.keys()
    for name in given:
        with pytest.raises(InputError, match=f"parameter {name} .* is missing"):
            plant_of(drive, load, {n: v for n, v in given.items() if n != name})


def test_what_a_load_cannot_do_is_refused(plant_of):
    plant = plant_of("duty", "pendulum", PENDULUM)
    with pytest.raises(InputError, match="2 joints for load 'pendulum'"):
        plant.step_model(2)
    with pytest.raises(InputError, match="no observer for a pendulum on a duty drive"):
        plant.step_model(1, "observer")


SERVO = {
    "mass_kg": 0.5, "arm_mass_kg": 0.0, "arm_length_m": 0.1, "rotor_inertia_1_kg_m2": 1e-3,
    "torque_constant_1_nm_a": 0.4, "winding_resistance_1_ohm": 3.0, "duty_gain_1": 0.5,
    "viscous_friction_1_nm_s_rad": 0.02, "presliding_1_rad": 5e-4, "current_limit_1_a": 3.0,
}  # fmt: skip
WEIGHT_NM = 0.5 * 9.81 * 0.1


def rest_of(model, changes, goal_rad, supply_v=7.0, enabled=1.0, seconds=8.0):
    """Angles and currents of a servo that starts at rest with a goal that stays."""
    u = np.tile([goal_rad, supply_v, enabled, 0.0], (round(seconds / 5e-3), 1))
    return model.simulate(u, 5e-3, model.parameter_values(changes))[:, :2]


def test_dry_friction_holds_a_servo_that_stands_and_lets_one_slide_that_it_cannot_hold(plant_of):
    effects = ["viscous_friction", "coulomb_friction"]
    model = plant_of("duty", "pendulum", SERVO, effects).step_model(1)
    friction_nm = 0.1
    for start_rad in (0.15, 0.6, 1.2):
        changes = {"coulomb_friction_1_nm": friction_nm, "start_offset_1_rad": start_rad}
        angle = rest_of(model, changes, 0.0, enabled=0.0)[:, 0]
        if WEIGHT_NM * np.sin(start_rad) < friction_nm:
            assert np.abs(angle - start_rad).max() < 5 * SERVO["presliding_1_rad"]
        else:
            assert np.abs(angle - start_rad).max() > 0.1
        assert WEIGHT_NM * abs(np.sin(angle[-1])) <= 1.01 * friction_nm
        assert np.ptp(angle[-400:]) < 1e-5  # no creep in the last two seconds


def test_a_changed_position_gain_scales_the_duty(plant_of):
    plant = plant_of("duty", "pendulum", SERVO, ["viscous_friction", "position_gain_change"])
    model = plant.step_model(1)
    other, changed = (
        rest_of(model, changes, 0.3, seconds=1.0)
        for changes in ({"duty_gain_1": 0.4}, {"position_gain_change_1": -0.2})
    )
    np.testing.assert_allclose(changed, other, rtol=0, atol=1e-9)


def test_friction_of_a_small_gear_grows_with_what_presses_it_from_both_sides(plant_of):
    """A weight is lifted from rest once T (1 − μ) > G (1 + μ), the teeth pressed by T + G."""
    share, start_rad = 0.25, 0.8
    plant = plant_of("duty", "pendulum", SERVO, ["viscous_friction", "load_dependent_friction"])
    model = plant.step_model(1)
    least_nm = WEIGHT_NM * np.sin(start_rad) * (1 + share) / (1 - share)
    moved = {}
    for factor in (0.93, 1.07):
        supply_v = 7.0
        error_rad = factor * least_nm * 3.0 / (0.4 * supply_v * SERVO["duty_gain_1"])
        changes = {"load_dependent_friction_1": share, "start_offset_1_rad": -error_rad}
        angle = rest_of(model, changes, start_rad + error_rad, supply_v, seconds=1.0)[:, 0]
        assert angle[0] == pytest.approx(start_rad)
        moved[factor] = angle[-1] - start_rad
    assert abs(moved[0.93]) < 0.01 < moved[1.07]


def test_the_current_of_a_duty_drive_stays_within_what_saturation_leaves_of_its_limit(plant_of):
    limited = SERVO | {"current_limit_1_a": 1.5}
    effects = ["viscous_friction", "current_saturation"]
    model = plant_of("duty", "pendulum", limited, effects).step_model(1)
    for cut_a in (0.0, 0.6):
        changes = {"current_saturation_1_a": cut_a, "start_offset_1_rad": -3.0}
        current = rest_of(model, changes, 3.0, seconds=0.5)[:, 1]
        assert current.max() == pytest.approx(1.5 - cut_a)


def test_what_a_document_knows_of_an_effect_holds_once_the_plant_holds_it(plant_of, tmp_path):
    plant = plant_of("duty", "pendulum", SERVO, ["viscous_friction"])
    path = tmp_path / "with.json"
    document = msgspec.to_builtins(plant.document())
    document["parameters"]["stribeck_load_1"] = {
        "value": 0.0, "bounds": [0.0, 0.4], "role": "effect"
    }  # fmt: skip
    path.write_text(json.dumps(document))
    read = read_plant(path)
    assert "stribeck_load_1" not in read.parameters
    again = tmp_path / "again.json"
    read.write(again)
    for known in (read, read_plant(again)):
        freed = known.with_effects("stribeck_friction").parameters["stribeck_load_1"]
        assert (freed.high, freed.role) == (0.4, "effect")
    names = [k.name for k in effect_fit_parameters(read, "stribeck_friction", 1)]
    assert "stribeck_load_1" in names
    assert "stribeck_load_1" not in [
        k.name for k in effect_fit_parameters(plant, "stribeck_friction", 1)
    ]


def test_directional_friction_is_its_own_viscous_friction_in_each_direction(plant_of):
    """Terminal speeds under a constant force: F / (B + a) forwards, F / (B − a) backwards."""
    mean_n_s_m, excess_n_s_m, force_n = 200.0, -40.0, 10.0
    parameters = {"mass_kg": 50.0, "force_constant_1_n_v": 1.0,
                  "viscous_friction_1_n_s_m": mean_n_s_m,
                  "directional_friction_1_n_s_m": excess_n_s_m}  # fmt: skip
    plant = plant_of("force", "mass", parameters, ["viscous_friction", "directional_friction"])
    model = plant.step_model(1)
    for way in (1, -1):
        u = np.tile([way * force_n, 0.0], (500, 1))
        speed_m_s = (model.simulate(u, 0.01)[-1, 0] - model.simulate(u, 0.01)[-2, 0]) / 0.01
        friction_n_s_m = mean_n_s_m + way * excess_n_s_m
        assert speed_m_s == pytest.approx(way * force_n / friction_n_s_m, rel=1e-6)


def test_only_a_straight_guide_has_directional_friction(plant_of):
    with pytest.raises(InputError, match="straight guide"):
        plant_of("duty", "pendulum", SERVO).with_effects("directional_friction")
