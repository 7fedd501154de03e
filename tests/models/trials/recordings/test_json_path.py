"""Paths into nested JSON, and trials imported by them."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.errors import InputError
from models.plant.plant import read_plant
from models.trials.files import read_trial
from models.trials.recordings.table import json_values

LOG = {
    "rig": {"load": {"force": [1.0, 2.0, 3.0], "mass_g": 250.0}, "name": "press"},
    "samples": [
        {"t": 0.0, "motor": {"position": 1.0, "phases": [5, 6]}},
        {"t": 0.1, "motor": {"position": 1.5, "phases": [7, 8]}},
        {"t": 0.2, "motor": {"phases": [9, 10]}},
    ],
    "a/b": {"c~d": [1, 2]},
}


@pytest.mark.parametrize(
    ("path", "values"),
    [
        ("samples[].motor.position", [1.0, 1.5, None]),
        ("/samples/*/motor/position", [1.0, 1.5, None]),
        ("samples[].motor.phases[1]", [6, 8, 10]),
        ("samples[1].motor.phases", [7, 8]),
        ("rig.load.force", [1.0, 2.0, 3.0]),
        ("/rig/load/force", [1.0, 2.0, 3.0]),
        ("/a~1b/c~0d", [1, 2]),
    ],
)
def test_a_path_leads_to_its_values(tmp_path, path, values):
    assert json_values(tmp_path, LOG, path) == values


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        ("samples[].motor.positon", "samples[].motor holds no 'positon'; it has 'position'"),
        ("sample[].t", "the file holds no 'sample'; it has 'rig', 'samples'"),
        ("samples.t", "samples holds no 't'; it is a list of 3: write '[]'"),
        ("rig[].force", "rig holds no list; it has 'load', 'name'"),
        ("samples[].motor", "not to a list of single values"),
        ("rig.name", "not to a list of single values"),
        ("samples[].motor.phases[]", "passes every entry of two lists"),
    ],
)
def test_a_wrong_path_is_refused_in_one_sentence(tmp_path, path, sentence):
    with pytest.raises(InputError) as refused:
        json_values(tmp_path, LOG, path)
    assert sentence in str(refused.value) and "\n" not in str(refused.value)


PLANT = """
schema = 1
name = "press"
drive = { kind = "measured" }
load = { kind = "mass" }
effects = []
[signals]
ram = { unit = "m", role = "supply", quantity = "position_1_m" }
push = { unit = "N", role = "measured", quantity = "force_1_n" }
moved = { unit = "kg", role = "condition", quantity = "mass_kg" }
[parameters]
mass_kg = 1.0
"""
MAP = """
plant = "plant.toml"
step_s = 0.01
[trial]
dof = 1
payload_kg = 0.0
trial = 1
motion = { from = "rig.speed" }
[conditions]
moved = { from = "rig.mass_g", unit = "g" }
[columns]
time_s = { from = "samples[].t_ms", unit = "ms" }
ram = { from = "samples[].motor.position", unit = "mm" }
push = { from = "channels.force", unit = "kN" }
"""


def test_a_nested_log_with_names_of_its_own_becomes_a_trial_by_the_plants_names(tmp_path):
    place_mm, force_kn = np.sin(np.arange(50) / 8), np.cos(np.arange(50) / 8)
    (tmp_path / "plant.toml").write_text(PLANT)
    (tmp_path / "map.toml").write_text(MAP)
    samples = [{"t_ms": 10.0 * k, "motor": {"position": p}} for k, p in enumerate(place_mm)]
    rig = {"mass_g": 250.0, "speed": 3}
    document = {"rig": rig, "samples": samples, "channels": {"force": force_kn.tolist()}}
    (tmp_path / "log.json").write_text(json.dumps(document))
    command = ["import", str(tmp_path / "log.json"), "--as", "table", "--out", str(tmp_path)]
    assert main([*command, "--map", str(tmp_path / "map.toml")]) == 0
    signals = read_signals(tmp_path)
    trial = read_trial(tmp_path / "log.csv", signals)
    assert "ram" in (tmp_path / "log.csv").read_text().partition("\n")[0]
    np.testing.assert_allclose(trial.columns["position_1_m"], 1e-3 * place_mm)
    np.testing.assert_allclose(trial.columns["force_1_n"], 1e3 * force_kn)
    assert trial.meta.conditions == {"mass_kg": 0.25} and trial.meta.motion == "3"


def read_signals(folder):
    return read_plant(folder / "plant.toml").signals


def test_a_plant_whose_signal_is_not_in_the_unit_of_its_quantity_is_refused(tmp_path, capsys):
    """In millimetres the numbers would be taken as metres, and every mass come out too small."""
    (tmp_path / "plant.toml").write_text(PLANT.replace('unit = "m",', 'unit = "mm",'))
    (tmp_path / "map.toml").write_text(MAP)
    samples = [{"t_ms": 10.0 * k, "motor": {"position": 0.5 * k}} for k in range(5)]
    document = {"rig": {"mass_g": 250.0, "speed": 3}, "samples": samples}
    (tmp_path / "log.json").write_text(json.dumps(document | {"channels": {"force": [0.0] * 5}}))
    command = ["import", str(tmp_path / "log.json"), "--as", "table", "--out", str(tmp_path)]
    assert main([*command, "--map", str(tmp_path / "map.toml")]) == 2
    said = capsys.readouterr().err
    assert "plant.toml: signal ram is given in 'mm', its quantity position_1_m in 'm'; give" in said
    assert not (tmp_path / "log.csv").exists()
    with pytest.raises(InputError, match="signal ram is given in 'mm'"):
        read_plant(tmp_path / "plant.toml")


def test_a_condition_in_another_unit_than_its_parameter_is_refused(tmp_path):
    (tmp_path / "plant.toml").write_text(PLANT.replace('unit = "kg",', 'unit = "N",'))
    with pytest.raises(InputError, match=r"moved is given in 'N', parameter mass_kg in 'k"):
        read_plant(tmp_path / "plant.toml")


def test_columns_of_different_length_are_refused(tmp_path, capsys):
    (tmp_path / "plant.toml").write_text(PLANT)
    (tmp_path / "map.toml").write_text(MAP)
    samples = [{"t_ms": 10.0 * k, "motor": {"position": 0.0}} for k in range(5)]
    rig = {"mass_g": 250.0, "speed": 3}
    document = {"rig": rig, "samples": samples, "channels": {"force": [1.0, 2.0]}}
    (tmp_path / "log.json").write_text(json.dumps(document))
    command = ["import", str(tmp_path / "log.json"), "--as", "table", "--out", str(tmp_path)]
    assert main([*command, "--map", str(tmp_path / "map.toml")]) == 2
    assert "'channels.force' has 2 values" in capsys.readouterr().err
