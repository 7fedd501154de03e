"""The example plants through import and evaluate, on recordings and on logs that we make."""

import json

import numpy as np
import pytest
import scipy.io

from dropstitch.__main__ import main
from models.plant.plant import NOMINAL, read_plant
from models.plant.simulation.runner import CompiledModel
from tests.real_data import real_recordings

EXAMPLES = NOMINAL.parent / "examples"
PENDULUM = EXAMPLES / "xl330_pendulum_identified.json"
CAR = EXAMPLES / "emps_identified.json"
STEP_S = 5e-3


@pytest.fixture
def evaluated(tmp_path, capsys):
    """Function (recordings, system, plant) -> errors by signal."""

    def run(files, system, plant):
        trials = str(tmp_path / "trials")
        table = ["--as", "table", "--map", str(EXAMPLES / f"{system}.map.toml"), "--out", trials]
        for file in files:
            assert main(["import", str(file), *table]) == 0
        capsys.readouterr()
        assert main(["evaluate", trials, "--plant", str(plant), "--json"]) == 0
        return json.loads(capsys.readouterr().out)["signals"]

    return run


@pytest.fixture(scope="module")
def pendulum():
    return CompiledModel(read_plant(PENDULUM).step_model(1))


def pendulum_log(compiled, path, kp, mass, length, supply_v=7.2):
    """Write a log as the rig does: lifted by its motor, then released; return the way it moved."""
    time_s = STEP_S * np.arange(600)
    goal_rad = -1.2 * np.sin(np.clip(time_s, 0, 1.5) * np.pi / 3)
    enabled = time_s < 1.8
    duty_gain = kp * 651.9 / (256 * 885)
    changes = {"duty_gain_1": duty_gain, "mass_kg": mass, "arm_length_m": length}
    u = np.column_stack([goal_rad, np.full(600, supply_v), enabled, np.zeros(600)])
    y = compiled.simulate(u[:-1], STEP_S, compiled.model.parameter_values(changes))
    entries = [
        {"timestamp": t, "goal_position": g, "position": a, "torque_enable": bool(e),
         "input_volts": supply_v}
        for t, g, a, e in zip(time_s, goal_rad, y[:, 0], enabled, strict=True)
    ]  # fmt: skip
    log = {"mass": mass, "length": length, "kp": kp, "trajectory": "lift", "entries": entries}
    path.write_text(json.dumps(log))
    return np.ptp(y[:, 0])


@pytest.mark.parametrize(("kp", "mass", "length"), [(150, 0.49, 0.1), (600, 0.3, 0.15)])
def test_conditions_of_a_log_reach_the_plant_by_its_map(
    evaluated, tmp_path, pendulum, kp, mass, length
):
    file = tmp_path / "log.json"
    moved = pendulum_log(pendulum, file, kp, mass, length)
    assert moved > 0.2
    angle = evaluated([file], "xl330_pendulum", PENDULUM)["angle_1_rad"]
    assert angle["mae"] < 1e-3 * moved


def test_a_recording_of_the_car_is_simulated_from_its_voltage(evaluated, tmp_path):
    time_s = 1e-3 * np.arange(2000)
    command_v = 2.0 * np.sin(2 * np.pi * time_s / 2.0)
    compiled = CompiledModel(read_plant(CAR).step_model(1))
    position_m = compiled.simulate(np.column_stack([command_v, 0 * time_s])[:-1], 1e-3)[:, 0]
    file = tmp_path / "car.mat"
    columns = {"t": time_s, "vir": command_v, "qm": 0.1 + position_m}
    scipy.io.savemat(file, {name: column[:, None] for name, column in columns.items()})
    position = evaluated([file], "emps", CAR)["position_1_m"]
    assert np.ptp(position_m) > 0.01
    assert position["rms"] < 1e-3 * np.ptp(position_m)


# Recordings of other machines


@pytest.mark.slow
def test_the_pendulum_follows_all_logs(evaluated):
    """Three quarters of what viscous and Coulomb friction alone miss, 62 mrad in the mean."""
    files = sorted(real_recordings("bam_xl330").glob("*.json"))
    assert evaluated(files, "xl330_pendulum", PENDULUM)["angle_1_rad"]["mae"] < 0.75 * 0.062


def test_the_car_follows_its_recording(evaluated):
    """Closer than with the published friction and offset, 3.0 mm."""
    files = real_recordings("emps").glob("*.mat")
    assert evaluated(files, "emps", CAR)["position_1_m"]["rms"] < 0.0030
