"""Recipes of docs/guides/extend.md, run as they are printed."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from dropstitch.__main__ import main as dropstitch
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import check_servo, read_models
from hil.faults import virtual_case
from hil.faults.faults_document import FaultCase, judge_case
from models.plant import components
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, simulate_plant
from models.trials import recordings
from models.trials.files import read_trial
from tests.hil.faults.toy_robot import PERIOD_S, ToyPhysics, toy_robot

ROOT = Path(__file__).resolve().parents[2]
RECIPES = (ROOT / "docs" / "guides" / "extend.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## ([^\n]+)\n(.*?)(?=^## |\Z)", RECIPES, re.MULTILINE | re.DOTALL))


def code(section):
    """Names that the Python blocks of a section leave behind."""
    space: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", SECTIONS[section], re.DOTALL):
        exec(compile(block, f"extend.md, {section}", "exec"), space)
    return space


def test_the_servo_turns_angles_into_pulses_and_back():
    row = re.search(r"```toml\n(.*?)```", SECTIONS["Add a servo"], re.DOTALL)[1]
    servos = (ROOT / "firmware_py" / "bus" / "servos.toml").read_text(encoding="utf-8")
    model = read_models(servos + row)[1120]
    check_servo(model.preset, "extend.md")
    assert model.position_raw(0.0) == 2048 and model.position_raw(np.pi / 2) == 3072
    assert model.angle_rad(3072) == pytest.approx(np.pi / 2)
    assert Register.BUS_WATCHDOG in model.table
    assert model.factory[Register.CURRENT_LIMIT] == 2047 and Register.SHUTDOWN in model.factory


def test_the_fault_ends_as_its_row_says(monkeypatch, tmp_path):
    monkeypatch.setattr(virtual_case, "FmuPhysics", ToyPhysics)
    row = code("Add a fault")["ROW"]
    for number in row.models:
        run = virtual_case.run_virtual(toy_robot(tmp_path), row, number, seed=1)
        assert judge_case(FaultCase(row, "virtual", number, 1), run, PERIOD_S).verdict == "pass"


def test_the_drive_follows_its_rate_and_has_exact_derivatives(monkeypatch, tmp_path):
    monkeypatch.setitem(components.DRIVES, "speed", code("Add a drive")["SpeedLoop"])
    path = tmp_path / "speed.toml"
    path.write_text(re.search(r"```toml\n(.*?)```", SECTIONS["Add a drive"], re.DOTALL)[1])
    plant = read_plant(path).with_values({"gravity_m_s2": 0.0})
    goal_rad_s = 0.5 * np.ones(300)
    rate_rad_s = np.diff(simulate_plant(plant, {"goal_1_rad_s": goal_rad_s})["angle_1_rad"]) / 0.017
    # a first-order lag without steady error: nothing but inertia loads it
    assert rate_rad_s[-1] == pytest.approx(0.5, abs=1e-6)
    gain = "speed_gain_1_a_s_rad"
    model = CompiledModel(plant.step_model(1, "twin"), [gain])
    u = goal_rad_s[:40, None]
    _, slopes = model.derivatives(u, 0.017)
    low, high = (
        model.simulate(u, 0.017, model.model.parameter_values({gain: value}))
        for value in (10.0 - 1e-4, 10.0 + 1e-4)
    )
    assert slopes[:, :, 0] == pytest.approx((high - low) / 2e-4, rel=1e-4, abs=1e-9)


MAP = """
step_s = 0.017
[trial]
dof = 1
payload_kg = 0.5
pressure_pa = 41300.0
trial = 2
motion = "sinusoid"
period_s = 4.352
amplitude_rad = 0.5236
base_offset_m = 0.06
link_length_m = 0.95
link_width_m = 0.15
"""


def test_the_importer_makes_a_trial_and_refuses_a_truncated_file(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(recordings.READERS, "npz", code("Add an importer")["read_npz"])
    command = importlib.import_module("models.commands.import_")
    monkeypatch.setattr(command, "KINDS", tuple(recordings.READERS))
    time_s = 0.017 * np.arange(200)
    angle_rad = 0.5 * np.sin(np.maximum(time_s - 0.5, 0.0))
    np.savez(
        tmp_path / "run.npz", time_s=time_s, angle_1_rad=angle_rad, goal_1_rad=angle_rad,
        current_1_a=np.zeros(200),
    )  # fmt: skip
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    arguments = ["--as", "npz", "--map", str(tmp_path / "map.toml"), "--out", str(tmp_path / "out")]
    assert dropstitch(["import", str(tmp_path / "run.npz"), *arguments]) == 0
    trial = read_trial(tmp_path / "out" / "run.csv")
    assert np.allclose(trial.angle_rad[:, 0], angle_rad[: len(trial)], atol=1e-12)
    whole = (tmp_path / "run.npz").read_bytes()
    (tmp_path / "run.npz").write_bytes(whole[: len(whole) // 2])
    arguments[-1] = str(tmp_path / "again")
    assert dropstitch(["import", str(tmp_path / "run.npz"), *arguments]) == 2
    assert "run.npz" in capsys.readouterr().err
