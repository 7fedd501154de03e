"""Logs of the robot as trials: bit for bit, and warned of where a log or its motion was cut off."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.registers import TORQUE_LOST
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.signals import PERIOD_S, tick_dtype
from firmware_py.log.recording import read_recording
from firmware_py.safety.states import SafetyState
from models.trials.files import read_trial
from models.trials.recordings import robot_log
from models.trials.recordings.mapping import RecordingMap, read_mapping
from tests.models.trials.recordings.written_takes import write_log

MAP = """
[trial]
payload_kg = 1.0
pressure_pa = 41300.0
trial = 1
base_offset_m = 0.06
link_length_m = 0.95
link_width_m = 0.15
"""
COUNT = 300


def records_of(dof):
    """Ticks without a gap, of random signals."""
    rng = np.random.default_rng(3)
    records = np.zeros(COUNT, tick_dtype(dof))
    for name in records.dtype.names:
        if records.dtype[name].kind == "f":
            records[name] = rng.standard_normal(COUNT) / 3
    records["tick"] = np.arange(COUNT)
    records["time_s"] = PERIOD_S * records["tick"]
    records["payload_kg"] = np.abs(records["payload_kg"])
    return records


@pytest.fixture
def run_import(tmp_path, capsys):
    """Function (log, map) -> exit code, printed JSON and standard error of the import."""

    def call(log, text=MAP):
        (tmp_path / "map.toml").write_text(text, encoding="utf-8")
        arguments = ["--as", "recording", "--map", tmp_path / "map.toml", "--out", tmp_path / "out"]
        code = main(["import", str(log), *map(str, arguments), "--json"])
        return code, *capsys.readouterr()

    return call


@pytest.fixture
def import_(run_import):
    """Function (log, map) -> imported trial and result."""

    def call(log, text=MAP):
        code, printed, err = run_import(log, text)
        assert code == 0, err
        return read_trial(json.loads(printed)["trial"]), json.loads(printed)

    return call


def stop_texts(result):
    return [f["text"] for f in result["findings"] if f["cause"] == "stop"]


@pytest.mark.parametrize("dof", [1, 2])
def test_a_log_becomes_a_trial_bit_for_bit(tmp_path, import_, dof):
    records = records_of(dof)
    trial, result = import_(write_log(tmp_path / "run.mcap", records, dof))
    assert (len(trial), result["cut_off"]) == (COUNT, [])
    columns = ["predicted_tip_x_m", "predicted_tip_y_m", "predicted_tip_z_m", "half_width_z_m"]
    for j in range(1, dof + 1):
        columns += [f"goal_{j}_rad", f"angle_{j}_rad", f"current_{j}_a"]
    for name in columns:
        assert trial.columns[name].tobytes() == records[name].tobytes(), name
    assert trial.columns["estimated_payload_kg"].tobytes() == records["payload_kg"].tobytes()


def test_a_log_that_was_cut_off_is_read_to_its_end(tmp_path, import_):
    path = write_log(tmp_path / "run.mcap", records_of(1), 1)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    trial, result = import_(path)
    assert result["cut_off"] == [str(path)]
    assert 0 < len(trial) < COUNT


def test_the_payload_is_that_of_the_map_or_of_the_log(tmp_path, import_, run_import):
    path = write_log(tmp_path / "run.mcap", records_of(1), 1, payload_kg="0.5")
    bare = MAP.replace("payload_kg = 1.0\n", "")
    assert import_(path, bare)[0].meta.payload_kg == 0.5
    assert import_(path)[0].meta.payload_kg == 1.0
    code, _, err = run_import(write_log(tmp_path / "bare.mcap", records_of(1), 1), bare)
    assert code == 2 and "payload_kg is missing" in err


@pytest.mark.parametrize(("head", "step_s"), [("", 0.01), ("step_s = 0.02\n", 0.02)])
def test_a_step_in_the_map_replaces_that_of_the_log(tmp_path, head, step_s):
    log = read_recording(write_log(tmp_path / "a.mcap", records_of(1), 1, period_s="0.01"))
    (tmp_path / "map.toml").write_text(head + MAP)
    mapping = robot_log.with_log_conditions(read_mapping(tmp_path / "map.toml"), log)
    assert mapping.step_s == step_s


APPROACH = 120
LATE_NS = 5_000_000


def swinging(approach=0, **columns):
    """Ticks of a slow swing after a rest of 60, sampled at once but for the rows that are named.

    Before it, the arm approaches its first goal from 0.3 rad.
    """
    records = np.zeros(approach + COUNT, tick_dtype(1))
    records[approach:] = records_of(1)
    records["tick"] = np.arange(approach + COUNT) - approach
    records["time_s"] = PERIOD_S * records["tick"]
    time_s = records["time_s"] - 60 * PERIOD_S
    records["goal_1_rad"] = np.where(time_s > 0, 0.2 * np.sin(2 * time_s), 0.0)
    lead = -0.15 * (1 + np.cos(np.pi * np.arange(approach) / APPROACH))
    records["goal_1_rad"][:approach] = lead
    records["angle_1_rad"] = records["goal_1_rad"]
    records["wake_ns"], records["read_ns"] = 80_000, 1_000_000
    for name, values in columns.items():
        records[name] = values
    return records


@pytest.mark.parametrize("late", [[100, 101, 102, 150], [0, 120, COUNT - 1]])
def test_samples_of_a_second_read_are_interpolated_to_their_row(tmp_path, late):
    records = swinging()
    exact = 0.2 * np.sin(2 * records["time_s"])
    records["angle_1_rad"] = records["current_1_a"] = exact
    records["bus_status"][late] = BusStatus.RETRIED
    records["sample_late_ns"] = records["wake_ns"]
    records["sample_late_ns"][late] += LATE_NS
    later = 0.2 * np.sin(2 * (records["time_s"] + LATE_NS * 1e-9))
    records["angle_1_rad"][late] = records["current_1_a"][late] = later[late]
    write_log(tmp_path / "run.mcap", records, 1)
    series = robot_log.read_robot_log(tmp_path / "run.mcap", RecordingMap())
    first = 1 if 0 in late else 0  # before the first sample nothing is known
    assert np.array_equal(series[0].columns["goal_1_rad"], records["goal_1_rad"])
    at_once = records["bus_status"][first:] == BusStatus.OK
    for name in ("angle_1_rad", "current_1_a"):
        column, raw = series[-1].columns[name], records[name][first:]
        assert column[at_once].tobytes() == raw[at_once].tobytes()
        assert np.abs(raw - exact[first:]).max() > 1e-3
        assert column == pytest.approx(exact[first:], abs=1e-4)


ENDS = {
    "alert": ({"alert": 32}, "571", "overload"),
    "torque": ({"alert": TORQUE_LOST}, "571", "its torque went off"),
    "no cause": ({"bus_status": BusStatus.ALERT}, "571", "cause unknown"),
    "stop": ({"state": SafetyState.STOPPING}, "571", "stops before the end"),
    "no slots": ({"state": SafetyState.STOPPING}, "", "stops before the end"),
    "stale": ({"state": SafetyState.STOPPING, "stale_ticks": 3}, "571", "without fresh data for 3"),
}


@pytest.mark.parametrize("name", ENDS)
def test_rows_from_an_early_end_on_are_left_out_with_a_warning(tmp_path, import_, name):
    """The end is told from the motion's begin, with an approach before it or without."""
    columns, slots, reason = ENDS[name]
    approach = APPROACH if name in ("torque", "stop") else 0
    records = swinging(approach)
    for column, value in columns.items():
        records[column][approach + 200 :] = value
    facts = {"slots": slots} if slots else {}
    trial, result = import_(write_log(tmp_path / "run.mcap", records, 1, **facts))
    assert (len(trial), trial.time_s[-1]) == (200, pytest.approx(199 * PERIOD_S))
    goals = records["goal_1_rad"][approach:][:200]
    assert trial.columns["goal_1_rad"].tobytes() == goals.tobytes()
    (text,) = stop_texts(result)
    assert "from tick 200 on, 3.40 s after its motion began" in text and reason in text


@pytest.mark.parametrize("facts", [{"slots": "250"}, {"motion": '{"motion": "plan_line"}'}])
def test_the_stop_after_the_motion_stays(tmp_path, import_, facts):
    records = swinging()
    records["state"][250:] = SafetyState.STOPPING
    if "slots" not in facts:  # nothing tells the end of a plan, but that it rests there
        records["goal_1_rad"][249:] = records["goal_1_rad"][249]
    text = MAP + "motion = 'swing'\nperiod_s = 4.0\namplitude_rad = 0.2\n"
    trial, result = import_(write_log(tmp_path / "run.mcap", records, 1, **facts), text)
    assert len(trial) == COUNT
    assert not stop_texts(result)


@pytest.mark.parametrize(
    ("column", "value", "row", "words"),
    [
        ("alert", 32, APPROACH + 70, "from tick 70 on, 1.19 s after"),
        ("state", SafetyState.STOPPING, 60, "run.mcap holds no motion"),
    ],
)
def test_an_end_before_the_motion_leaves_no_trial(tmp_path, run_import, column, value, row, words):
    records = swinging(APPROACH)
    records[column][row:] = value
    code, _, err = run_import(write_log(tmp_path / "run.mcap", records, 1, slots="571"))
    assert code == 2 and words in err and err.count("\n") == 1
    assert not list((tmp_path / "out").glob("*.csv"))


def test_a_trial_begins_with_its_motion_not_with_the_approach(tmp_path, import_):
    known = {"motion": "swing", "period_s": 4.1, "amplitude_rad": 0.2, "phase_2_rad": 0.0}
    records = swinging(APPROACH)
    log = write_log(tmp_path / "run.mcap", records, 1, motion=json.dumps(known))
    trial, result = import_(log)
    assert (len(trial), trial.meta.rest_samples) == (COUNT, 60)
    for name in ("goal_1_rad", "angle_1_rad", "current_1_a", "predicted_tip_x_m"):
        assert trial.columns[name].tobytes() == records[name][APPROACH:].tobytes(), name
    assert result["findings"] == []


def test_goals_from_another_program_state_their_duration_and_reach(tmp_path, import_):
    records = swinging()
    path = write_log(tmp_path / "run.mcap", records, 1, motion='{"motion": "outside"}')
    trial, result = import_(path)
    assert (trial.meta.motion, trial.meta.rest_samples) == ("outside", 60)
    assert trial.meta.amplitude_rad == np.abs(records["goal_1_rad"]).max()
    assert trial.meta.period_s == pytest.approx(PERIOD_S * (COUNT - 60))
    assert not [f for f in result["findings"] if "amplitude_rad" in f["text"]]


def test_a_log_of_a_fourier_motion_is_not_taken_for_the_motion_beside_it(tmp_path, run_import):
    """Releases up to 0.3 ran such motions; `kind` and the rest kept their defaults."""
    motion = {"kind": "sinusoid", "period_s": 4.352, "amplitude_rad": 0.5, "phase_2_rad": 0.0}
    config = json.dumps({"motion": motion | {"design": {"harmonics": [1]}}, "payload_kg": 1.0})
    path = write_log(tmp_path / "run.mcap", swinging(), 1, config=config)
    code, _, err = run_import(path)
    assert code == 2 and "motion" in err and err.count("\n") == 1
