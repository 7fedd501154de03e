"""Loads and drives other than the link's, against textbook solutions."""

import json

import msgspec
import numpy as np
import pytest
from scipy import signal
from scipy.special import ellipk

from firmware_py.core.errors import InputError
from models.gap.residuals.fit_parameters import effect_candidates
from models.plant.identification.evaluation import compare_with_trials
from models.plant.plant import read_plant
from models.plant.step_model import names
from models.trials.trial import Trial, TrialMeta

PENDULUM = {
    "mass_kg": 0.5, "arm_mass_kg": 0.2, "arm_length_m": 0.3, "rotor_inertia_1_kg_m2": 1e-4,
    "torque_constant_1_nm_a": 0.01, "winding_resistance_1_ohm": 50.0, "duty_gain_1": 0.01,
    "current_limit_1_a": 3.0,
}  # fmt: skip


@pytest.mark.parametrize("amplitude_rad", [0.02, 2.0])
def test_a_pendulum_swings_with_the_period_of_the_elliptic_integral(plant_with, amplitude_rad):
    model = plant_with("duty", "pendulum", PENDULUM).step_model(1)
    x, at = np.zeros(len(model.states)), names(model.states).index("joint_1_rad")
    x[at] = amplitude_rad
    step_s, payload_kg = 5e-3, 0.3
    u = np.tile([0.0, 0.0, 1.0, payload_kg], (400, 1))
    angles = model.simulate(u, step_s, x=x)[1:, 0]
    down = np.flatnonzero((angles[:-1] > 0) & (angles[1:] <= 0))
    crossings = (down + 1 + angles[down] / (angles[down] - angles[down + 1])) * step_s
    q, length = PENDULUM, PENDULUM["arm_length_m"]
    inertia = (q["mass_kg"] + payload_kg + q["arm_mass_kg"] / 3) * length**2 + 1e-4
    moment = (q["mass_kg"] + payload_kg + q["arm_mass_kg"] / 2) * 9.81 * length
    expected = 4 * np.sqrt(inertia / moment) * ellipk(np.sin(amplitude_rad / 2) ** 2)
    assert np.diff(crossings) == pytest.approx(expected, rel=2e-3)


def test_a_motor_holds_the_pendulum_where_torque_and_gravity_agree(plant_with):
    changes = {"duty_gain_1": 2.0, "torque_constant_1_nm_a": 0.4, "winding_resistance_1_ohm": 2.0}
    plant = plant_with("duty", "pendulum", PENDULUM | changes, ["viscous_friction"])
    model = plant.step_model(1)
    p = model.parameter_values({"viscous_friction_1_nm_s_rad": 0.5})
    u = np.tile([1.0, 6.0, 1.0, 0.0], (800, 1))
    angle, current = model.simulate(u, 0.01, p)[-1, :2]
    gravity = (0.5 + 0.1) * 9.81 * 0.3 * np.sin(angle)
    assert 0.4 * current == pytest.approx(gravity, rel=1e-4)
    assert current == pytest.approx(2.0 * (1.0 - angle) * 6.0 / 2.0, rel=1e-6)


def test_a_mass_under_a_constant_force_moves_by_half_a_t_squared(plant_with):
    plant = plant_with("force", "mass", {"mass_kg": 95.0, "force_constant_1_n_v": 35.0})
    model = plant.step_model(1)
    assert names(model.inputs) == ["command_1_v", "payload_kg"]
    y = model.simulate(np.tile([0.5, 5.0], (100, 1)), 0.01)
    time_s = 0.01 * np.arange(101)
    assert y[:, 0] == pytest.approx(0.5 * 35.0 * 0.5 / 100.0 * time_s**2, abs=1e-9)


def test_directional_friction_differs_by_direction(plant_with):
    """Terminal speeds under a constant force: F / (B + a) forwards, F / (B − a) backwards."""
    mean_n_s_m, excess_n_s_m, force_n = 200.0, -40.0, 10.0
    parameters = {"mass_kg": 50.0, "force_constant_1_n_v": 1.0,
                  "viscous_friction_1_n_s_m": mean_n_s_m,
                  "directional_friction_1_n_s_m": excess_n_s_m}  # fmt: skip
    plant = plant_with("force", "mass", parameters, ["viscous_friction", "directional_friction"])
    for way in (1, -1):
        y = plant.step_model(1).simulate(np.tile([way * force_n, 0.0], (500, 1)), 0.01)[:, 0]
        friction_n_s_m = mean_n_s_m + way * excess_n_s_m
        assert (y[-1] - y[-2]) / 0.01 == pytest.approx(way * force_n / friction_n_s_m, rel=1e-6)


@pytest.mark.parametrize(
    ("drive", "load", "constants"),
    [
        ("duty", "pendulum", "duty_gain_1 mass_kg arm_length_m"),
        ("current", "flexible_link", "torque_constant_1_nm_a link_inertia_kg_m2"),
        ("force", "mass", "force_constant_1_n_v mass_kg"),
    ],
)
def test_a_constant_of_the_machine_has_no_default(plant_with, drive, load, constants):
    values = dict.fromkeys(constants.split(), 2.0)
    assert plant_with(drive, load, values).parameters.keys() >= values.keys()
    for name in values:
        with pytest.raises(InputError, match=rf"plant\.toml: .*{name} .*is missing.*give it in"):
            plant_with(drive, load, {n: v for n, v in values.items() if n != name})


def test_what_a_load_cannot_do_is_refused(plant_with):
    plant = plant_with("duty", "pendulum", PENDULUM)
    with pytest.raises(InputError, match="2 joints for load 'pendulum'"):
        plant.step_model(2)
    with pytest.raises(InputError, match="no observer for a pendulum on a duty drive"):
        plant.step_model(1, "observer")


SERVO = {
    "mass_kg": 0.5, "arm_mass_kg": 0.0, "arm_length_m": 0.1, "rotor_inertia_1_kg_m2": 1e-3,
    "torque_constant_1_nm_a": 0.4, "winding_resistance_1_ohm": 3.0, "duty_gain_1": 0.5,
    "presliding_1_rad": 5e-4, "current_limit_1_a": 1.5,
}  # fmt: skip
WEIGHT_NM = 0.5 * 9.81 * 0.1


@pytest.fixture(scope="module")
def servo(plant_with):
    """Function (changes, goal) -> angles and currents of a servo that starts at rest."""
    effects = ["viscous_friction", "coulomb_friction", "position_gain_change",
               "load_dependent_friction", "current_saturation"]  # fmt: skip
    model = plant_with("duty", "pendulum", SERVO, effects).step_model(1)

    def run(changes, goal_rad, enabled=1.0, seconds=8.0):
        u = np.tile([goal_rad, 7.0, enabled, 0.0], (round(seconds / 5e-3), 1))
        p = model.parameter_values({"viscous_friction_1_nm_s_rad": 0.02} | changes)
        return model.simulate(u, 5e-3, p)[:, :2]

    return run


@pytest.mark.parametrize("start_rad", [0.15, 1.2])
def test_dry_friction_stops_a_servo_until_the_weight_exceeds_it(servo, start_rad):
    friction_nm = 0.1
    changes = {"coulomb_friction_1_nm": friction_nm, "start_offset_1_rad": start_rad}
    angle = servo(changes, 0.0, enabled=0.0)[:, 0]
    moved = np.abs(angle - start_rad).max()
    if WEIGHT_NM * np.sin(start_rad) < friction_nm:
        assert moved < 5 * SERVO["presliding_1_rad"]
    else:
        assert moved > 0.1
    assert WEIGHT_NM * abs(np.sin(angle[-1])) <= 1.01 * friction_nm
    assert np.ptp(angle[-400:]) < 1e-5  # no creep in the last two seconds


def test_a_changed_position_gain_scales_the_duty(servo):
    cases = {"duty_gain_1": 0.4}, {"position_gain_change_1": -0.2}
    expected, changed = (servo(changes, 0.3, seconds=1.0) for changes in cases)
    np.testing.assert_allclose(changed, expected, rtol=0, atol=1e-9)


def test_friction_of_a_small_gear_grows_with_the_torque_from_both_sides(servo):
    """A weight is lifted from rest once T (1 − μ) > G (1 + μ), the teeth pressed by T + G."""
    share, start_rad = 0.25, 0.8
    least_nm = WEIGHT_NM * np.sin(start_rad) * (1 + share) / (1 - share)
    moved = []
    for factor in (0.93, 1.07):
        error_rad = factor * least_nm * 3.0 / (0.4 * 7.0 * SERVO["duty_gain_1"])
        changes = {"load_dependent_friction_1": share, "start_offset_1_rad": -error_rad}
        angle = servo(changes, start_rad + error_rad, seconds=1.0)[:, 0]
        assert angle[0] == pytest.approx(start_rad)
        moved.append(angle[-1] - start_rad)
    assert abs(moved[0]) < 0.01 < moved[1]


def test_the_current_of_a_duty_drive_stays_below_its_reduced_limit(servo):
    for cut_a in (0.0, 0.6):
        changes = {"current_saturation_1_a": cut_a, "start_offset_1_rad": -3.0}
        assert servo(changes, 3.0, seconds=0.5)[:, 1].max() == pytest.approx(1.5 - cut_a)


def test_a_file_may_set_parameters_of_an_effect_that_the_plant_lacks(plant_with, tmp_path):
    plant = plant_with("duty", "pendulum", SERVO, ["viscous_friction"])
    document = msgspec.to_builtins(plant.document())
    document["parameters"]["stribeck_load_1"] = {
        "value": 0.0, "bounds": [0.0, 0.4], "role": "effect"
    }  # fmt: skip
    (tmp_path / "with.json").write_text(json.dumps(document))
    read = read_plant(tmp_path / "with.json")
    assert "stribeck_load_1" not in read.parameters
    read.write(tmp_path / "again.json")
    for known in (read, read_plant(tmp_path / "again.json")):
        freed = known.with_effects("stribeck_friction").parameters["stribeck_load_1"]
        assert (freed.high, freed.role) == (0.4, "effect")
    for known, free in ((read, True), (plant, False)):
        fitted = [
            k.name for k in effect_candidates(known, "stribeck_friction", 1)["stribeck_friction"]
        ]
        assert ("stribeck_load_1" in fitted) == free


STEP_S = 0.002
TIME_S = np.arange(2000) * STEP_S
ANGLE_RAD = 0.3 * np.sin(2 * np.pi * 0.7 * TIME_S) ** 2
FOLLOWED = signal.lsim(signal.lti([-0.2, 0, 0], [0.2, 0.3, 20.0]), ANGLE_RAD, TIME_S)[1]
"""Deflection by the transfer function −J s² / (J s² + c s + k) [a base-excited oscillator]."""
DECAY, OMEGA = 0.3 / 0.4, np.sqrt(20.0 / 0.2 - (0.3 / 0.4) ** 2)
FREE = 0.05 * np.exp(-DECAY * TIME_S) * np.cos(OMEGA * TIME_S + 0.7)
"""Free decay of an underdamped oscillator, which starts with a deflection and a rate."""


@pytest.mark.parametrize(
    ("angle_rad", "deflection_rad", "limit_rad"),
    [(ANGLE_RAD, FOLLOWED, 0.02 * np.std(FOLLOWED)), (0 * TIME_S + 0.4, FREE, 0.02 * 0.05)],
    ids=["driven", "free"],
)
def test_a_flexible_links_deflection_is_that_of_an_oscillator(
    plant_with, angle_rad, deflection_rad, limit_rad
):
    link = {"link_inertia_kg_m2": 0.2, "root_stiffness_1_nm_rad": 20.0,
            "root_damping_1_nm_s_rad": 0.3, "follow_rate_per_s": 500.0}  # fmt: skip
    meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="test", source="measured",
                     period_s=4.0, rest_samples=0)  # fmt: skip
    columns = {"time_s": TIME_S, "angle_1_rad": angle_rad, "deflection_1_rad": deflection_rad}
    plant = plant_with("measured", "flexible_link", link)
    (run,) = compare_with_trials(plant, [Trial("test", meta, columns)])
    error_rad = run.error("deflection_1_rad")
    assert np.sqrt(np.mean(error_rad**2)) < limit_rad / 2
    assert np.abs(error_rad).max() < limit_rad
