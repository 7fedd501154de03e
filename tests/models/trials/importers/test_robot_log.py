"""Our own logs as trials: to the bit, and with a word where a log was cut off."""

import json

import msgspec
import numpy as np
import pytest

from firmware_py.config import RobotConfig
from firmware_py.log.sinks import McapSink, TickEncoder
from firmware_py.signals import PERIOD_S, tick_dtype
from models.__main__ import main
from models.trials.trial_files import read_trial

MAP = """
[trial]
payload_kg = 1.0
pressure_pa = 41300.0
trial = 1
base_offset_m = 0.06
link_length_m = 0.95
link_width_m = 0.15
"""
CONFIG = {"bundle": "b", "bus": {"port": "p"}, "servos": [{"id": 1, "model": "H54-200-S500-R"}]}
COUNT = 300


def records_of(dof):
    """Ticks without a gap, full of digits, from a fixed seed."""
    rng = np.random.default_rng(3)
    records = np.zeros(COUNT, tick_dtype(dof))
    for name in records.dtype.names:
        if records.dtype[name].kind == "f":
            records[name] = rng.standard_normal(COUNT) / 3
    records["tick"] = np.arange(COUNT)
    records["time_s"] = PERIOD_S * records["tick"]
    records["payload_kg"] = np.abs(records["payload_kg"])
    return records


def log_of(path, records, dof, **metadata):
    config = msgspec.json.encode(msgspec.convert(CONFIG, RobotConfig)).decode()
    facts = {"dof": str(dof), "period_s": repr(PERIOD_S), "config": config} | metadata
    sink, encode = McapSink(str(path), dof, facts), TickEncoder(dof, 10**18)
    for record in records:
        sink.write(*encode(record.tobytes()))
    sink.finish()
    return path


@pytest.fixture
def import_(tmp_path, capsys):
    """Import a log; return the trial and what was said."""

    def import_(log, text=MAP):
        (tmp_path / "map.toml").write_text(text, encoding="utf-8")
        arguments = ["--as", "recording", "--map", tmp_path / "map.toml", "--out", tmp_path / "out"]
        assert main(["import", str(log), *map(str, arguments), "--json"]) == 0
        result = json.loads(capsys.readouterr().out)
        return read_trial(result["trial"]), result

    return import_


@pytest.mark.parametrize("dof", [1, 2])
def test_a_log_becomes_a_trial_without_the_loss_of_a_bit(tmp_path, import_, dof):
    records = records_of(dof)
    trial, result = import_(log_of(tmp_path / "run.mcap", records, dof))
    assert (len(trial), result["cut_off"]) == (COUNT, [])
    columns = ["predicted_tip_x_m", "predicted_tip_y_m", "predicted_tip_z_m", "half_width_z_m"]
    for j in range(1, dof + 1):
        columns += [f"goal_{j}_rad", f"angle_{j}_rad", f"current_{j}_a"]
    for name in columns:
        assert trial.columns[name].tobytes() == records[name].tobytes(), name
    assert trial.columns["estimated_payload_kg"].tobytes() == records["payload_kg"].tobytes()


def test_a_log_that_was_cut_off_says_so(tmp_path, import_, capsys):
    path = log_of(tmp_path / "run.mcap", records_of(1), 1)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    trial, result = import_(path)
    assert result["cut_off"] == [str(path)]
    assert 0 < len(trial) < COUNT
    arguments = ["--as", "recording", "--map", tmp_path / "map.toml", "--out", tmp_path / "out"]
    assert main(["import", str(path), *map(str, arguments)]) == 0
    assert f"{path} was cut off" in capsys.readouterr().out


def test_the_payload_is_what_the_log_knows(tmp_path, import_):
    path = log_of(tmp_path / "run.mcap", records_of(1), 1, payload_kg="0.5")
    assert import_(path, MAP.replace("payload_kg = 1.0\n", ""))[0].meta.payload_kg == 0.5
    assert import_(path)[0].meta.payload_kg == 1.0, "the map's own word holds"
