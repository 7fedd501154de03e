import json

import numpy as np
import pytest
import scipy.io

from firmware_py.errors import InputError
from models.trials.files import read_trial, write_trial
from models.trials.recordings.mapping import read_mapping
from models.trials.recordings.table import read_columns, read_table


@pytest.fixture
def log(session):
    """Everything in one log of one clock, in awkward units."""
    columns = {"stamp_ms": session.servo_true_s * 1e3}
    mapping = {"time_s": {"from": "stamp_ms", "unit": "ms"}}
    for j in range(1, session.dof + 1):
        columns |= {
            f"q{j}": -np.degrees(session.angle_rad[:, j - 1]),
            f"i{j}": 1e3 * session.current_a[:, j - 1] + 20,
        }
        mapping |= {
            f"angle_{j}_rad": {"from": f"q{j}", "unit": "deg", "scale": -1.0},
            f"goal_{j}_rad": {"from": f"q{j}", "unit": "deg", "scale": -1.0},
            f"current_{j}_a": {"from": f"i{j}", "unit": "mA", "offset": -0.02},
        }
    for i in range(16):
        for k, axis in enumerate("xyz"):
            seen = session.markers_m[:, i, k]
            columns[f"P{i}{axis}"] = 1e3 * np.interp(session.servo_true_s, session.mocap_s, seen)
            mapping[f"m{i + 1:02d}_{axis}_m"] = {"from": f"P{i}{axis}", "unit": "mm"}
    return columns, mapping


def write_text(path, columns, delimiter):
    rows = zip(*columns.values(), strict=True)
    lines = [delimiter.join(columns), *(delimiter.join(map(repr, map(float, r))) for r in rows)]
    path.write_text("\n".join(lines))


def write_json(path, columns, form):
    lists = {k: v.tolist() for k, v in columns.items()}
    records = [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]
    forms = {"lists": lists, "records": records, "nested": {"motor": "x", "entries": records}}
    path.write_text(json.dumps(forms[form]))


@pytest.mark.parametrize("form", ["csv", "tsv", "semicolon", "lists", "records", "nested", "mat"])
def test_every_kind_of_table_becomes_the_true_trial(
    session, log, write_map, run, check, tmp_path, form
):
    columns, mapping = log
    if form in ("csv", "tsv", "semicolon"):
        file = tmp_path / f"log.{form[:3]}"
        write_text(file, columns, {"csv": ",", "tsv": "\t", "semicolon": ";"}[form])
    elif form == "mat":
        file = tmp_path / "log.mat"
        matrix = {k: v[:, None] for k, v in columns.items()}
        scipy.io.savemat(file, matrix | {"gain": 3.0, "other": np.arange(7.0)})
    else:
        file = tmp_path / "log.json"
        write_json(file, columns, form)
    map_ = write_map(session.dof, columns=mapping, step_s=0.02)
    code, _, err = run(file, "--as", "table", "--map", map_, "--name", "one")
    assert code == 0, err
    trial = read_trial(tmp_path / "trials" / "one.csv")
    assert trial.step_s == pytest.approx(0.02)
    check(trial, session.servo_true_s[0], session.dof, 1e-3)


def test_a_trial_passes_through_bit_for_bit(make_trial, swing_rad, write_map, run, tmp_path):
    trial = make_trial(swing_rad)
    trial.columns["m05_y_m"][8] = np.nan
    trial.columns["temperature_1_degc"] = np.linspace(30, 31, len(trial))
    file = write_trial(trial, tmp_path / "source")
    code, _, err = run(file, "--as", "table", "--map", write_map(2))
    assert code == 0, err
    back = read_trial(tmp_path / "trials" / "run.csv")
    assert list(back.columns) == list(trial.columns)
    for name, column in trial.columns.items():
        assert np.array_equal(back.columns[name], column, equal_nan=True), name
    assert back.meta.rest_samples == trial.meta.rest_samples  # found from the goals


def test_goals_are_held_and_never_mixed(make_trial, swing_rad, write_map, run, tmp_path):
    trial = make_trial(swing_rad)
    trial.columns["goal_1_rad"] = np.where(np.arange(len(trial)) < 30, 0.0, 0.5)
    file = write_trial(trial, tmp_path / "source")
    assert run(file, "--as", "table", "--map", write_map(2, step_s=0.005))[0] == 0
    back = read_trial(tmp_path / "trials" / "run.csv")
    assert set(np.unique(back.goal_rad[:, 0])) == {0.0, 0.5}
    assert back.time_s[np.argmax(back.goal_rad[:, 0] > 0)] == pytest.approx(30 * 0.017, abs=0.005)


def test_a_servo_log_without_markers_is_a_trial_without_markers(
    session, servo_csv, write_map, run, tmp_path
):
    log, columns = servo_csv
    map_ = write_map(session.dof, columns=columns)
    assert run(log, "--as", "table", "--map", map_)[0] == 0
    trial = read_trial(tmp_path / "trials" / "servo.csv")
    assert np.isnan(trial.markers_m).all() and np.isfinite(trial.angle_rad).all()


def test_columns_of_other_plants_are_read_by_the_same_reader(tmp_path):
    """An XL330 pendulum log and an EMPS recording differ in their map only."""
    file = tmp_path / "log.json"
    entries = [
        {"timestamp": 0.005 * k, "position": 0.1 * k, "load": k, "torque_enable": True}
        for k in range(5)
    ]
    file.write_text(json.dumps({"mass": 0.49, "motor": "xl330", "entries": entries}))
    map_ = tmp_path / "map.toml"
    map_.write_text(
        "[columns]\n"
        'time_s = { from = "timestamp" }\n'
        'angle_1_rad = { from = "position" }\n'
        'duty_1 = { from = "load", scale = 0.001 }\n'
    )
    (series,) = read_table(file, read_mapping(map_))
    assert series.time_s.tolist() == [e["timestamp"] for e in entries]
    assert series.columns["duty_1"] == pytest.approx([0, 0.001, 0.002, 0.003, 0.004])
    scipy.io.savemat(tmp_path / "a.mat", {"t": np.arange(5.0), "qm": np.ones((5, 1)), "kp": 160.0})
    assert set(read_columns(tmp_path / "a.mat")) == {"t", "qm"}


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"angle_1_rad": {"from": "nope"}}, "column 'nope' (mapped to angle_1_rad) is missing"),
        ({"angle_1_rad": {"from": "pos1", "unit": "furlong"}}, "unit 'furlong' is unknown"),
        ({"angle_1_rad": {"from": "pos1", "unit": "mA"}}, "does not measure rad"),
        ({"angle_1_rad": {"from": "pos1", "unit": "rad"}}, "it is in deg"),
        ({"angle_1_rad": {"from": "status1"}}, "'OK' is not a number"),
        ({"angle_1_rad": None}, "nothing holds angle_1_rad"),
        ({"time_s": None}, "no column is mapped to time_s"),
        ({"time_s": {"from": "pos1", "unit": "s"}}, "does not measure"),
        ({"time_s": {"from": "cur1", "unit": "s"}}, "time does not increase after sample"),
    ],
)
def test_a_wrong_map_gets_one_sentence(session, servo_csv, write_map, refused, change, what):
    log, columns = servo_csv
    columns = {k: v for k, v in (columns | change).items() if v is not None}
    if what == "does not measure":
        columns["time_s"]["unit"] = "deg"
    sentence = refused(log, "--as", "table", "--map", write_map(session.dof, columns=columns))
    assert what in sentence


@pytest.mark.parametrize(
    ("table", "what"),
    [
        ("servo_columns", "its columns stand under [servo_columns], for the file of --servo: name "
         "them under [columns] in MAP.toml"),
        ("columns", "add time_s = { from = \"…\", unit = \"s\" } under [columns] in MAP.toml"),
    ],
)  # fmt: skip
def test_a_table_of_the_map_for_another_file_is_named(
    session, servo_csv, write_map, refused, table, what
):
    log, columns = servo_csv
    if table == "columns":
        del columns["time_s"]
    map_ = write_map(session.dof, **{table: columns})
    assert what in refused(log, "--as", "table", "--map", map_)


def test_columns_of_the_servo_under_those_of_the_recording_are_named(session, servo_csv, write_map):
    log, columns = servo_csv
    angle = {"angle_1_rad": columns["angle_1_rad"]}
    path = write_map(session.dof, columns=columns, servo_columns=angle)
    what = r"stand under \[columns\], for the recording itself: name them under \[servo_columns\]"
    with pytest.raises(InputError, match=what):
        read_table(log, read_mapping(path).for_servo())


@pytest.mark.parametrize("form", ["csv", "records"])
def test_an_infinite_cell_is_told_as_that(session, log, write_map, refused, tmp_path, form):
    columns, mapping = log
    columns["i1"][6] = np.inf
    if form == "csv":
        file, what = tmp_path / "log.csv", "row 8, column 'i1': 'inf' is not a finite number"
        write_text(file, columns, ",")
    else:
        file, what = tmp_path / "log.json", "sample 7: current_1_a is inf, not a finite number"
        write_json(file, columns, form)
    map_ = write_map(session.dof, columns=mapping, step_s=0.02)
    assert f"{file}: {what}; " in refused(file, "--as", "table", "--map", map_)


def test_wrong_conditions_and_files_get_one_sentence(
    session, servo_csv, write_map, refused, tmp_path
):
    log, columns = servo_csv
    arguments = (log, "--as", "table", "--map")
    for trial, what in (
        ({"payload_kg": None}, "payload_kg"),
        ({"payload_kg": "heavy"}, "payload_kg"),
        ({"dof": 3}, "dof is 3"),
        ({"colour": "blue"}, "colour"),
    ):
        map_ = write_map(session.dof, columns=columns, trial=trial)
        assert what in refused(*arguments, map_)
    map_ = write_map(session.dof, columns=columns, colour="blue")
    assert "colour" in refused(*arguments, map_)
    map_ = write_map(session.dof, columns=columns, step_s=0.0)
    assert "step_s is 0.0" in refused(*arguments, map_)
    map_ = write_map(session.dof, columns=columns, markers={"m17": "x"})
    assert "'m17' is no marker" in refused(*arguments, map_)
    map_.write_text("[trial")
    assert "is not TOML" in refused(*arguments, map_)
    assert "is missing" in refused(*arguments, tmp_path / "none.toml")
    map_ = write_map(session.dof, columns=columns)
    for name, content, what in (
        ("a.json", "{", "is not JSON"),
        ("a.json", '{"note": "nothing"}', "holds no columns"),
        ("a.mat", "no matlab", "is not a MATLAB file"),
        ("a.csv", "a,b\n1,2\n3\n", "row 3 has 1 cells, the header 2"),
        ("a.csv", "", "holds no columns"),
    ):
        (tmp_path / name).write_text(content)
        assert what in refused(tmp_path / name, "--as", "table", "--map", map_)
