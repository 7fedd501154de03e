"""Our own logs as trials: to the bit, and with a word where a log or its motion was cut off."""

import json

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.registers import TORQUE_LOST
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.config import RobotConfig
from firmware_py.log.recording import read_recording
from firmware_py.log.sinks import McapSink, TickEncoder
from firmware_py.safety.states import SafetyState
from firmware_py.signals import PERIOD_S, tick_dtype
from models.trials.files import read_trial
from models.trials.recordings import robot_log
from models.trials.recordings.mapping import RecordingMap, read_mapping

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


LATE_NS = 5_000_000


def swinging(**columns):
    """Ticks of a slow swing after a rest of 60, sampled at once but for the rows that are named."""
    records = records_of(1)
    time_s = records["time_s"] - 60 * PERIOD_S
    records["goal_1_rad"] = np.where(time_s > 0, 0.2 * np.sin(2 * time_s), 0.0)
    records["angle_1_rad"] = records["goal_1_rad"]
    records["wake_ns"], records["read_ns"] = 80_000, 1_000_000
    for name, values in columns.items():
        records[name] = values
    return records


@pytest.mark.parametrize("late", [[100, 101, 102, 150], [0, 120, COUNT - 1]])
def test_samples_of_a_second_read_are_those_of_the_time_of_their_row(tmp_path, late):
    records = swinging()
    exact = 0.2 * np.sin(2 * records["time_s"])
    records["angle_1_rad"] = records["current_1_a"] = exact
    records["bus_status"][late] = BusStatus.RETRIED
    records["sample_late_ns"] = records["wake_ns"]
    records["sample_late_ns"][late] += LATE_NS
    later = 0.2 * np.sin(2 * (records["time_s"] + LATE_NS * 1e-9))
    records["angle_1_rad"][late] = records["current_1_a"][late] = later[late]
    log_of(tmp_path / "run.mcap", records, 1)
    series = robot_log.read_robot_log(tmp_path / "run.mcap", RecordingMap())
    first = 1 if 0 in late else 0  # before the first sample nothing is known
    assert np.array_equal(series[0].columns["goal_1_rad"], records["goal_1_rad"])
    at_once = records["bus_status"][first:] == BusStatus.OK
    for name in ("angle_1_rad", "current_1_a"):
        own, raw = series[-1].columns[name], records[name][first:]
        assert own[at_once].tobytes() == raw[at_once].tobytes()
        assert np.abs(raw - exact[first:]).max() > 1e-3
        assert own == pytest.approx(exact[first:], abs=1e-4)


ENDS = {
    "alert": ({"alert": 32}, {}, "a servo raises an alert (overload)"),
    "torque": ({"alert": TORQUE_LOST}, {}, "a servo raises an alert (its torque went off)"),
    "no cause": ({"bus_status": BusStatus.ALERT}, {}, "a servo raises an alert (cause unknown)"),
    "stop": ({"state": SafetyState.STOPPING}, {}, "the robot stops before the end of its motion"),
    "no slots": ({"state": SafetyState.STOPPING}, {"slots": None}, "stops before the end of its"),
    "stale": (
        {"state": SafetyState.STOPPING, "stale_ticks": 3}, {}, "motion, without fresh data for 3",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ENDS)
def test_rows_from_an_early_end_on_are_left_out_with_a_word(tmp_path, import_, name):
    columns, facts, reason = ENDS[name]
    records, row = swinging(), 200
    for column, value in columns.items():
        records[column][row:] = value
    known = {key: value for key, value in ({"slots": "571"} | facts).items() if value}
    trial, result = import_(log_of(tmp_path / "run.mcap", records, 1, **known))
    assert len(trial) == row
    assert trial.columns["goal_1_rad"].tobytes() == records["goal_1_rad"][:row].tobytes()
    (said,) = [f["text"] for f in result["findings"] if f["cause"] == "stop"]
    began = "what run.mcap holds from tick 200 on, 3.40 s after its motion began, is left out: "
    assert said.startswith(began)
    assert reason in said


@pytest.mark.parametrize("facts", [{"slots": "250"}, {"motion": '{"motion": "plan_line"}'}])
def test_the_stop_after_the_motion_stays(tmp_path, import_, facts):
    records = swinging()
    records["state"][250:] = SafetyState.STOPPING
    if "slots" not in facts:  # nothing tells the end of a plan, but that it rests there
        records["goal_1_rad"][249:] = records["goal_1_rad"][249]
    text = MAP + "motion = 'swing'\nperiod_s = 4.0\namplitude_rad = 0.2\n"
    trial, result = import_(log_of(tmp_path / "run.mcap", records, 1, **facts), text)
    assert len(trial) == COUNT
    assert not [f for f in result["findings"] if f["cause"] == "stop"]


def test_an_alert_before_the_motion_leaves_no_trial(tmp_path, capsys):
    records = swinging()
    records["alert"][70:] = 32
    path = log_of(tmp_path / "run.mcap", records, 1)
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    words = f"import {path} --as recording --map {tmp_path}/map.toml --out {tmp_path}/out"
    assert main(words.split()) == 2
    said = capsys.readouterr().err
    assert "from tick 70 on, 1.19 s after" in said and said.count("\n") == 1
    assert not list((tmp_path / "out").glob("*.csv"))


def test_goals_from_outside_tell_their_duration_and_reach(tmp_path, import_):
    records = swinging()
    path = log_of(tmp_path / "run.mcap", records, 1, motion='{"motion": "outside"}')
    trial, result = import_(path)
    meta = trial.meta
    assert (meta.motion, meta.rest_samples) == ("outside", 60)
    assert meta.amplitude_rad == np.abs(records["goal_1_rad"]).max()
    assert meta.period_s == pytest.approx(PERIOD_S * (COUNT - 60))
    assert not [f for f in result["findings"] if "amplitude_rad" in f["text"]]


APPROACH = 120


def after_an_approach(**columns):
    """The same swing by an arm that leaned by 0.3 rad, and the ticks that lead it to rest."""
    records = np.zeros(APPROACH + COUNT, tick_dtype(1))
    records[APPROACH:] = swinging()
    lead = np.arange(APPROACH)
    records["tick"][:APPROACH] = lead - APPROACH
    records["time_s"][:APPROACH] = PERIOD_S * (lead - APPROACH)
    records["goal_1_rad"][:APPROACH] = -0.15 * (1 + np.cos(np.pi * lead / APPROACH))
    records["angle_1_rad"] = records["goal_1_rad"]
    for name, values in columns.items():
        records[name] = values
    return records


def test_a_trial_begins_with_its_motion_not_with_the_approach(tmp_path, import_):
    motion = json.dumps(
        {"motion": "swing", "period_s": 4.1, "amplitude_rad": 0.2, "phase_2_rad": 0.0}
    )
    records = after_an_approach()
    trial, result = import_(log_of(tmp_path / "run.mcap", records, 1, motion=motion))
    assert (len(trial), trial.meta.rest_samples) == (COUNT, 60)
    for name in ("goal_1_rad", "angle_1_rad", "current_1_a", "predicted_tip_x_m"):
        assert trial.columns[name].tobytes() == records[name][APPROACH:].tobytes(), name
    assert result["findings"] == []


def test_the_time_of_an_early_end_is_one_of_the_trial(tmp_path, import_):
    state = np.zeros(APPROACH + COUNT, int)
    state[APPROACH + 200 :] = SafetyState.STOPPING
    log = log_of(tmp_path / "run.mcap", after_an_approach(state=state), 1, slots="571")
    trial, result = import_(log)
    assert len(trial) == 200
    (said,) = [f["text"] for f in result["findings"] if f["cause"] == "stop"]
    assert "from tick 200 on, 3.40 s after" in said
    assert trial.time_s[-1] == pytest.approx(3.40 - PERIOD_S)


def test_a_stop_during_the_approach_leaves_no_trial(tmp_path, capsys):
    state = np.zeros(APPROACH + COUNT, int)
    state[60:] = SafetyState.STOPPING
    path = log_of(tmp_path / "run.mcap", after_an_approach(state=state), 1, slots="571")
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    words = f"import {path} --as recording --map {tmp_path}/map.toml --out {tmp_path}/out"
    assert main(words.split()) == 2
    said = capsys.readouterr().err
    assert "run.mcap holds no motion" in said


def test_goals_that_begin_beside_zero_have_the_amplitude_of_their_plan(tmp_path, import_):
    """A plan says its largest goal; from a first one of the other sign it is twice as far."""
    records = swinging()
    records["goal_1_rad"] = records["angle_1_rad"] = 0.1 * np.cos(
        np.maximum(records["time_s"] - 60 * PERIOD_S, 0.0)
    )
    for amplitude_rad, fits in ((0.1, True), (0.2, True), (0.4, False)):
        known = {"motion": "plan_line", "period_s": 4.0, "amplitude_rad": amplitude_rad}
        path = log_of(tmp_path / f"{amplitude_rad}.mcap", records, 1, motion=json.dumps(known))
        found = [f["text"] for f in import_(path)[1]["findings"] if f["cause"] == "amplitude"]
        assert fits == (not found), amplitude_rad


def test_a_step_that_the_map_states_counts_even_where_it_is_the_nominal_one(tmp_path):
    log = read_recording(log_of(tmp_path / "a.mcap", records_of(1), 1, period_s="0.01"))
    for head, step_s in (("", 0.01), ("step_s = 0.017\n", 0.017), ("step_s = 0.02\n", 0.02)):
        (tmp_path / "map.toml").write_text(head + MAP)
        mapping = robot_log.with_log_conditions(read_mapping(tmp_path / "map.toml"), log)
        assert mapping.step_s == step_s
