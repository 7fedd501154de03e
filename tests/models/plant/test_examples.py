"""The example plants through the commands that a researcher types, on logs that we make."""

import json

import numpy as np
import pytest
import scipy.io

from dropstitch.__main__ import main
from models.plant.plant import NOMINAL, read_plant
from models.plant.simulation.runner import CompiledModel

EXAMPLES = NOMINAL.parent / "examples"
KP_TO_DUTY = 651.9 / (256 * 885)
STEP_S = 5e-3


def evaluate(tmp_path, capsys, file, rig, plant):
    """Import one recording and evaluate a plant on it."""
    trials = tmp_path / "trials"
    command = ["import", str(file), "--as", "table", "--map", str(EXAMPLES / f"{rig}.map.toml")]
    assert main([*command, "--out", str(trials)]) == 0
    capsys.readouterr()
    assert main(["evaluate", str(trials), "--plant", str(plant), "--json"]) == 0
    return json.loads(capsys.readouterr().out)["signals"]


@pytest.fixture(scope="module")
def pendulum():
    path = EXAMPLES / "xl330_pendulum_identified.json"
    return path, CompiledModel(read_plant(path).step_model(1))


def pendulum_log(compiled, kp, mass, length, supply_v=7.2):
    """A log as the rig writes it: lifted by its motor, then let go."""
    time_s = STEP_S * np.arange(600)
    goal_rad = -1.2 * np.sin(np.clip(time_s, 0, 1.5) * np.pi / 3)
    enabled = time_s < 1.8
    changes = {"duty_gain_1": kp * KP_TO_DUTY, "mass_kg": mass, "arm_length_m": length}
    u = np.column_stack([goal_rad, np.full(600, supply_v), enabled, np.zeros(600)])
    y = compiled.simulate(u[:-1], STEP_S, compiled.model.parameter_values(changes))
    rows = zip(time_s, goal_rad, y[:, 0], enabled, strict=True)
    entries = [
        {"timestamp": t, "goal_position": g, "position": a, "torque_enable": bool(e),
         "input_volts": supply_v}
        for t, g, a, e in rows
    ]  # fmt: skip
    return {"mass": mass, "length": length, "kp": kp, "trajectory": "lift", "entries": entries}


@pytest.mark.parametrize(("kp", "mass", "length"), [(150, 0.49, 0.1), (600, 0.3, 0.15)])
def test_a_log_of_other_conditions_is_told_by_its_map(tmp_path, capsys, pendulum, kp, mass, length):
    path, compiled = pendulum
    file = tmp_path / "log.json"
    log = pendulum_log(compiled, kp, mass, length)
    file.write_text(json.dumps(log))
    angle = evaluate(tmp_path, capsys, file, "xl330_pendulum", path)["angle_1_rad"]
    moved = np.ptp([row["position"] for row in log["entries"]])
    assert moved > 0.2
    assert angle["mae"] < 1e-3 * moved


def test_a_plant_that_lacks_the_friction_is_told_from_one_that_has_it(tmp_path, capsys, pendulum):
    file = tmp_path / "log.json"
    file.write_text(json.dumps(pendulum_log(pendulum[1], 400, 0.49, 0.1)))
    nominal = EXAMPLES / "xl330_pendulum.toml"
    assert evaluate(tmp_path, capsys, file, "xl330_pendulum", nominal)["angle_1_rad"]["mae"] > 0.02


def test_a_recording_of_the_car_is_simulated_from_its_voltage(tmp_path, capsys):
    path = EXAMPLES / "emps_identified.json"
    compiled = CompiledModel(read_plant(path).step_model(1))
    time_s = 1e-3 * np.arange(2000)
    command_v = 2.0 * np.sin(2 * np.pi * time_s / 2.0)
    position_m = compiled.simulate(np.column_stack([command_v, 0 * time_s])[:-1], 1e-3)[:, 0]
    file = tmp_path / "car.mat"
    columns = {"t": time_s, "vir": command_v, "qm": 0.1 + position_m}
    scipy.io.savemat(file, {name: column[:, None] for name, column in columns.items()})
    position = evaluate(tmp_path, capsys, file, "emps", path)["position_1_m"]
    assert np.ptp(position_m) > 0.01
    assert position["rms"] < 1e-3 * np.ptp(position_m)
