"""Recordings in every format become the true trial: tables, Motive, C3D, ROS 2 bags, QTM, TRC."""

import json

import numpy as np
import pytest
import scipy.io
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from models.plant.plant import read_plant
from models.trials.files import read_trial, write_trial
from models.trials.importing import import_recordings
from models.trials.recordings.mapping import RecordingMap, read_mapping
from models.trials.recordings.table import json_values, read_table
from tests.models.trials.recordings.written_takes import motive_export, write_c3d


@pytest.fixture
def importing(servo_csv, write_map, run):
    """Function (file, format, options, tables of the map) -> an import with the servo's log."""
    log, columns = servo_csv

    def call(file, kind, *options, **tables):
        map_ = write_map(columns=columns, **tables)
        return run(file, "--as", kind, "--servo", log, "--map", map_, *options)

    return call


# --- tables ---------------------------------------------------------------------------------------


@pytest.fixture
def log(session):
    """Everything in one log of one clock, in awkward units."""
    columns = {"stamp_ms": session.servo_true_s * 1e3}
    mapping = {"time_s": {"from": "stamp_ms", "unit": "ms"}}
    for j in (1, 2):
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
            place_m = session.markers_m[:, i, k]
            columns[f"P{i}{axis}"] = 1e3 * np.interp(session.servo_true_s, session.mocap_s, place_m)
            mapping[f"m{i + 1:02d}_{axis}_m"] = {"from": f"P{i}{axis}", "unit": "mm"}
    return columns, mapping


def write_table(path, columns, form):
    """The columns as text with a delimiter, as a MATLAB file, or as JSON of lists or records."""
    if form == "mat":
        matrix = {k: v[:, None] for k, v in columns.items()}
        scipy.io.savemat(path, matrix | {"gain": 3.0, "other": np.arange(7.0)})
    elif form in ",\t;":
        rows = zip(*columns.values(), strict=True)
        lines = [form.join(columns), *(form.join(map(repr, map(float, r))) for r in rows)]
        path.write_text("\n".join(lines))
    else:
        lists = {k: v.tolist() for k, v in columns.items()}
        records = [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]
        path.write_text(json.dumps(lists if form == "lists" else {"motor": "x", "rows": records}))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "form"),
    [("log.csv", ","), ("log.tsv", "\t"), ("log.csv", ";"), ("log.json", "lists"),
     ("log.json", "records"), ("log.mat", "mat")],
)  # fmt: skip
def test_every_form_of_a_table_becomes_the_true_trial(
    session, log, write_map, run, check, tmp_path, name, form
):
    columns, mapping = log
    write_table(tmp_path / name, columns, form)
    map_ = write_map(columns=mapping, step_s=0.02)
    code, _, err = run(tmp_path / name, "--as", "table", "--map", map_, "--name", "one")
    assert code == 0, err
    trial = check(tmp_path / "trials" / "one.csv", session.first_s, 1e-3)
    assert trial.step_s == pytest.approx(0.02)


def test_a_trial_passes_through_bit_for_bit(make_trial, swing_rad, write_map, run, tmp_path):
    trial = make_trial(swing_rad)
    trial.columns["m05_y_m"][8] = np.nan
    trial.columns["temperature_1_degc"] = np.linspace(30, 31, len(trial))
    file = write_trial(trial, tmp_path / "source")
    code, _, err = run(file, "--as", "table", "--map", write_map())
    assert code == 0, err
    back = read_trial(tmp_path / "trials" / "run.csv")
    assert list(back.columns) == list(trial.columns)
    for name, column in trial.columns.items():
        assert np.array_equal(back.columns[name], column, equal_nan=True), name
    assert back.meta.rest_samples == trial.meta.rest_samples  # counted in the goals


def test_a_log_without_markers_is_a_trial_without_markers(servo_csv, write_map, run, tmp_path):
    log, columns = servo_csv
    assert run(log, "--as", "table", "--map", write_map(columns=columns))[0] == 0
    trial = read_trial(tmp_path / "trials" / "servo.csv")
    assert np.isnan(trial.markers_m).all() and np.isfinite(trial.angle_rad).all()


def test_vectors_and_columns_of_a_matrix_are_read_from_matlab(tmp_path):
    scipy.io.savemat(
        tmp_path / "a.mat",
        {"t": np.arange(40.0), "x": np.arange(80.0).reshape(40, 2), "kp": 160.0, "s": np.ones(3)},
    )
    (tmp_path / "map.toml").write_text(
        '[columns]\ntime_s = { from = "t" }\nduty_1 = { from = "x[1]", scale = 0.5 }\n'
    )
    (series,) = read_table(tmp_path / "a.mat", read_mapping(tmp_path / "map.toml"))
    assert series.columns["duty_1"] == pytest.approx(0.5 + np.arange(40))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"angle_1_rad": {"from": "nope"}}, "column 'nope' (mapped to angle_1_rad) is missing"),
        ({"angle_1_rad": {"from": "pos1", "unit": "furlong"}}, "unit 'furlong' is unknown"),
        ({"angle_1_rad": {"from": "pos1", "unit": "mA"}}, "does not measure rad"),
        ({"angle_1_rad": {"from": "status1"}}, "'OK' is not a number"),
        ({"angle_1_rad": None}, "nothing holds angle_1_rad"),
        ({"time_s": None}, "no column is mapped to time_s"),
        ({"time_s": {"from": "cur1", "unit": "s"}}, "time does not increase after sample"),
    ],
)
def test_a_map_that_does_not_fit_is_refused_by_column(servo_csv, write_map, refused, change, what):
    log, columns = servo_csv
    columns = {k: v for k, v in (columns | change).items() if v is not None}
    assert what in refused(log, "--as", "table", "--map", write_map(columns=columns))


def test_the_table_of_the_map_that_was_used_is_named(servo_csv, write_map, refused):
    log, columns = servo_csv
    sentence = refused(log, "--as", "table", "--map", write_map(servo_columns=columns))
    assert "[columns]" in sentence and "[servo_columns]" in sentence


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("a.json", "{", "is not JSON"),
        ("a.json", '{"note": "nothing"}', "holds no columns"),
        ("a.mat", "no matlab", "is not a MATLAB file"),
        ("a.csv", "", "holds no columns"),
        ("a.csv", "a,ms\n0,017,1,5\n", "decimal commas"),
        ("a.csv", "Taken by\tme\nt\tx\ty\n0.1\t1.5\t2.5\n", "rows that stand above the header"),
    ],
)
def test_a_wrong_table_is_refused_by_its_fault(
    servo_csv, write_map, refused, tmp_path, name, content, what
):
    (tmp_path / name).write_text(content)
    map_ = write_map(columns=servo_csv[1])
    assert what in refused(tmp_path / name, "--as", "table", "--map", map_)


# --- nested JSON, and plants with signals of their own --------------------------------------------

NESTED = {
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
        ("/a~1b/c~0d", [1, 2]),
    ],
)
def test_a_path_leads_to_its_values(tmp_path, path, values):
    assert json_values(tmp_path, NESTED, path) == values


@pytest.mark.parametrize(
    ("path", "what"),
    [
        ("samples[].motor.positon", "samples[].motor holds no 'positon'; it has 'position'"),
        ("samples.t", "write '[]'"),
        ("samples[].motor.phases[]", "passes every entry of two lists"),
    ],
)
def test_a_wrong_path_is_refused_where_it_ends(tmp_path, path, what):
    with pytest.raises(InputError) as refused:
        json_values(tmp_path, NESTED, path)
    assert what in str(refused.value)


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
PLANT_MAP = """
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


@pytest.fixture
def import_press(tmp_path):
    """Function (positions, forces) -> exit code of the import of a nested log."""

    def call(place_mm, force_kn):
        (tmp_path / "plant.toml").write_text(PLANT)
        (tmp_path / "map.toml").write_text(PLANT_MAP)
        samples = [{"t_ms": 10.0 * k, "motor": {"position": p}} for k, p in enumerate(place_mm)]
        document = {"rig": {"mass_g": 250.0, "speed": 3}, "samples": samples}
        document["channels"] = {"force": list(force_kn)}
        (tmp_path / "log.json").write_text(json.dumps(document))
        command = ["import", str(tmp_path / "log.json"), "--as", "table", "--out", str(tmp_path)]
        return main([*command, "--map", str(tmp_path / "map.toml")])

    return call


def test_a_nested_log_becomes_a_trial_with_the_names_of_its_plant(import_press, tmp_path):
    place_mm, force_kn = np.sin(np.arange(50) / 8), np.cos(np.arange(50) / 8)
    assert import_press(place_mm.tolist(), force_kn.tolist()) == 0
    trial = read_trial(tmp_path / "log.csv", read_plant(tmp_path / "plant.toml").signals)
    assert "ram" in (tmp_path / "log.csv").read_text().partition("\n")[0]
    np.testing.assert_allclose(trial.columns["position_1_m"], 1e-3 * place_mm)
    np.testing.assert_allclose(trial.columns["force_1_n"], 1e3 * force_kn)
    assert trial.meta.conditions == {"mass_kg": 0.25} and trial.meta.motion == "3"
    (take,) = import_recordings(
        tmp_path / "log.json", "table", tmp_path, mapping=tmp_path / "map.toml"
    )
    assert take.trial().sha256() == trial.sha256()


def test_columns_of_different_length_are_refused(import_press, capsys):
    assert import_press([0.0] * 5, [1.0, 2.0]) == 2
    assert "'channels.force' has 2 values" in capsys.readouterr().err


# --- marker exports as text: QTM and TRC ----------------------------------------------------------

PLACES_MM = np.arange(18.0).reshape(3, 2, 3) + 0.25
"""Of two markers in three samples."""
MARKERS = RecordingMap(markers={"m01": "Link A", "m02": "Link B"})


def rows(times=True):
    return [
        "\t".join([*([str(k + 1), f"{k / 100:.5f}"] if times else []), *map(str, mm.ravel())])
        for k, mm in enumerate(PLACES_MM)
    ]


def qtm(form):
    facts = [
        "NO_OF_FRAMES\t3", "NO_OF_CAMERAS\t8", "NO_OF_MARKERS\t2", "FREQUENCY\t100",
        "TIME_STAMP\t2026-11-28, 10:00:00.000\t1234.5", "DATA_INCLUDED\t3D",
        "MARKER_NAMES\tLink A\tLink B", "TRAJECTORY_TYPES\tMeasured\tMeasured",
    ]  # fmt: skip
    if form == "column header":
        names = "\t".join(f"{name} {axis}" for name in ("Link A", "Link B") for axis in "XYZ")
        facts.append(f"Frame\tTime\t{names}")
    return [*facts, *rows(times=form != "positions only")]


def trc(form):
    tail = "\t" if form == "trailing tabs" else ""
    return [
        "PathFileType\t4\t(X/Y/Z)\ttake.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate",
        f"100\t100\t3\t2\t{'m' if form == 'metres' else 'mm'}\t100",
        "Frame#\tTime\tLink A\t\t\tLink B\t\t",
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
        *([""] if form == "blank row" else []),
        *(row + tail for row in rows()),
    ]


@pytest.mark.parametrize(
    ("make", "form", "end", "unit_m"),
    [(qtm, "column header", "\n", 1e-3), (qtm, "times", "\r\n", 1e-3),
     (qtm, "positions only", "\n", 1e-3), (trc, "blank row", "\r\n", 1e-3),
     (trc, "trailing tabs", "\n", 1e-3), (trc, "metres", "\n", 1.0)],
)  # fmt: skip
def test_an_export_has_time_and_markers_by_their_names(make, form, end, unit_m, tmp_path):
    path = tmp_path / "take.tsv"
    path.write_text(end.join(make(form)) + end, newline="")
    (series,) = read_table(path, MARKERS)
    assert series.time_s == pytest.approx([0.0, 0.01, 0.02])
    for k in range(2):
        assert series.position_m(f"m{k + 1:02d}") == pytest.approx(PLACES_MM[:, k] * unit_m)


def test_an_export_may_lack_a_marker_but_no_cells(tmp_path):
    path = tmp_path / "take.tsv"
    lines = qtm("column header")
    lines[-1] = "\t".join([*lines[-1].split("\t")[:5], "", "", ""])
    path.write_text("\n".join(lines))
    (series,) = read_table(path, MARKERS)
    assert np.isnan(series.position_m("m02")[-1]).all()
    lines[-1] = "3\t0.02\t1.0"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="row 12 has 3 cells, the header 8"):
        read_table(path, MARKERS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("NO_OF_FRAMES\t1\nMARKER_NAMES\tA\n1.0\t2.0\t3.0\n", "neither times nor FREQUENCY"),
        ("PathFileType\t4\n", "without names of markers"),
        ("NO_OF_FRAMES\t1\nMARKER_NAMES" + "\tA" * 400 + "\n1.0\n", "has 400 markers, more than"),
    ],
)
def test_an_export_without_a_whole_header_is_refused(text, words, tmp_path):
    (tmp_path / "take.tsv").write_text(text)
    with pytest.raises(InputError, match=words):
        read_table(tmp_path / "take.tsv", MARKERS)


# --- Motive ---------------------------------------------------------------------------------------


def write_motive(path, time_s, markers_m, *, version="1.23", units="Meters"):
    """A Motive export: y up, a rigid body in front, gaps blank."""
    per_metre = {"Meters": 1, "Centimeters": 100, "Millimeters": 1000}[units]
    places = per_metre * np.stack([markers_m[..., 0], markers_m[..., 2], -markers_m[..., 1]], -1)
    labels = [f"Link:M{i:02d}" for i in range(1, 17)]
    options = {"units": units, "version": version, "solved": True}
    path.write_text(motive_export(time_s, labels, places, **options))
    return path


@pytest.mark.parametrize(
    ("version", "units", "label"),
    [("1.23", "Meters", ""), ("1.2", "Millimeters", ""), ("1.25", "Centimeters", "Arm:Marker 0")],
)
def test_motive_with_a_servo_log_becomes_the_true_trial(
    session, importing, check, tmp_path, version, units, label
):
    """Other labels are mapped by name."""
    file = write_motive(
        tmp_path / "take.csv", session.mocap_s, session.markers_m, version=version, units=units
    )
    tables = {}
    if label:
        file.write_text(file.read_text().replace("Link:M", label))
        code, _, err = importing(file, "motive")
        assert code == 2 and f"{label}01" in err
        tables = {"markers": {f"m{i:02d}": f"{label}{i:02d}" for i in range(1, 17)}}
    code, out, err = importing(file, "motive", "--json", **tables)
    assert code == 0, err
    result = json.loads(out)
    assert result["offset_s"] == pytest.approx(session.offset_s, abs=2e-4)
    assert result["correlation"] > 0.9999
    trial = check(result["trial"], session.first_s)
    assert trial.step_s == pytest.approx(0.017)
    assert (trial.meta.dof, trial.meta.source) == (2, "measured")
    moved = np.abs(trial.goal_rad - trial.goal_rad[0]).max(axis=1) > 1e-3
    assert (0.5 - 0.2) / 0.017 < trial.meta.rest_samples < np.argmax(moved)  # no reference motion


@pytest.mark.slow
def test_blank_cells_are_occluded_markers_and_short_gaps_of_the_tip_are_bridged(
    session, importing, check, tmp_path
):
    markers_m = session.markers_m.copy()
    markers_m[300:330, 6] = np.nan
    markers_m[300:600, 12] = np.nan  # one corner of the tip: the other diagonal still has it
    take = write_motive(tmp_path / "take.csv", session.mocap_s, markers_m)
    assert importing(take, "motive")[0] == 0
    trial = check(tmp_path / "trials" / "take.csv", session.first_s)
    gone = np.isnan(trial.markers_m[:, :, 0]).sum(axis=0)
    assert np.flatnonzero(gone).tolist() == [6, 12]
    assert gone[[6, 12]] == pytest.approx(np.array([30, 300]) / 240 / 0.017, abs=2)
    markers_m[300:312, 12:] = np.nan  # 50 ms
    short = write_motive(tmp_path / "short.csv", session.mocap_s, markers_m)
    assert importing(short, "motive")[0] == 0
    check(tmp_path / "trials" / "short.csv", session.first_s, 4e-3)
    markers_m[300:348, 12:] = np.nan  # 200 ms
    long = write_motive(tmp_path / "long.csv", session.mocap_s, markers_m)
    code, _, err = importing(long, "motive")
    assert code == 2 and "tip is unseen for 0.2" in err


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("Format Version", "Version", "is no Motive export"),
        ("Length Units,Meters", "Length Units,Feet", "Length Units is 'Feet'"),
        ("Space,Global", "Space,Local", "Coordinate Space is Local"),
        (",Name,", ",Label,", "lacks its"),
        ("\nFrame,", "\nFrames,", "no row that begins with Frame"),
        ("\n0,0.000000,", "\n0,oops,", "column 'Time (Seconds)': 'oops' is not a number"),
        ("\n3,0.012500,", "\n3,0.001000,", "time does not increase after sample 3"),
        (",Position,", ",Rotation,", "0 columns for Y of m16"),
    ],
)
def test_a_damaged_export_is_refused_by_its_fault(
    session, write_map, refused, tmp_path, old, new, what
):
    file = write_motive(tmp_path / "take.csv", session.mocap_s[:9], session.markers_m[:9])
    text = file.read_text()
    head, _, tail = text.rpartition(old)  # the last one: of the measured markers
    assert tail
    file.write_text(head + new + tail)
    sentence = refused(file, "--as", "motive", "--map", write_map())
    assert what in sentence and "take.csv" in sentence
    file.write_text(text[:-300])
    assert "truncated" in refused(file, "--as", "motive", "--map", write_map())


# --- C3D ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "origin_m"), [("mm", [0.1, -0.2, 0.42]), ("m", [0.0, 0.0, 0.0])])
def test_c3d_with_a_servo_log_becomes_the_true_trial(
    session, importing, check, tmp_path, unit, origin_m
):
    """Zeros of the file are an occlusion, wherever its origin lies."""
    in_file_m = session.markers_m + np.array(origin_m)
    in_file_m[400:420, 3] = np.nan
    in_file_m[600:620, 12] = 0.0
    file = write_c3d(tmp_path / "take.c3d", in_file_m, unit=unit)
    code, _, err = importing(file, "c3d", frame={"origin_m": origin_m})
    assert code == 0, err
    assert "m13 in 20 samples" in err
    trial = check(tmp_path / "trials" / "take.csv", session.first_s)
    gone = np.isnan(trial.markers_m).any(axis=2).sum(axis=0)
    assert np.flatnonzero(gone).tolist() == [3, 12]
    assert gone[[3, 12]] == pytest.approx(20 / 240 / 0.017, abs=2)


def test_analog_channels_have_the_clock_of_the_markers(session, write_map, run, check, tmp_path):
    fine_s = np.arange(2 * len(session.mocap_s)) / 480
    analogs, columns = {}, {}
    for j in (1, 2):
        angle = np.interp(fine_s, session.servo_true_s, session.angle_rad[:, j - 1])
        analogs |= {f"A{j}": ("deg", np.degrees(angle)), f"C{j}": ("mA", 3000 * angle)}
        columns |= {
            f"angle_{j}_rad": {"from": f"A{j}"},
            f"goal_{j}_rad": {"from": f"A{j}"},
            f"current_{j}_a": {"from": f"C{j}", "unit": "mA"},
        }
    file = write_c3d(tmp_path / "take.c3d", session.markers_m, analogs=analogs)
    code, _, err = run(file, "--as", "c3d", "--map", write_map(columns=columns))
    assert code == 0, err
    check(tmp_path / "trials" / "take.csv", 0.0)


def test_wrong_c3d_files_are_refused_with_their_fault(session, write_map, refused, tmp_path):
    file = tmp_path / "take.c3d"
    arguments = (file, "--as", "c3d", "--map", write_map())
    file.write_bytes(b"no c3d at all" * 100)
    assert "is not C3D" in refused(*arguments)
    for fields, words in (
        ({"labels": [f"P{i}" for i in range(16)]}, "P0, P1"),
        ({"unit": "parsec"}, "POINT:UNITS is 'parsec'"),
        ({}, "nothing holds goal_1_rad"),
    ):
        write_c3d(file, session.markers_m[:9], **fields)
        assert words in refused(*arguments)
    file.unlink()
    assert "is missing" in refused(*arguments)


# --- ROS 2 bags -----------------------------------------------------------------------------------

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
EPOCH_S = 1_700_000_000
TOPICS = {"/joint_states": "joints", "/goals": "goals", "/markers": "markers"}


def header(time_s):
    whole = int(np.floor(time_s))
    stamp = T["builtin_interfaces/msg/Time"](EPOCH_S + whole, int((time_s - whole) * 1e9))
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id="mocap")


def point(p):
    return T["geometry_msgs/msg/Point"](*map(float, p))


def pose(p):
    upright = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return T["geometry_msgs/msg/Pose"](point(p), upright)


def joint_state(time_s, angle, current, names):
    none = np.zeros(0)
    return T["sensor_msgs/msg/JointState"](
        header(time_s), names, np.array(angle, float), none, np.array(current, float)
    )


def marker_array(time_s, row):
    kind = T["visualization_msgs/msg/Marker"]
    rgba = T["std_msgs/msg/ColorRGBA"](0.0, 0.0, 0.0, 0.0)
    still = T["builtin_interfaces/msg/Duration"](0, 0)
    size = T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    image = T["sensor_msgs/msg/CompressedImage"](header(0), "", np.zeros(0, np.uint8))
    mesh = T["visualization_msgs/msg/MeshFile"]("", np.zeros(0, np.uint8))
    return T["visualization_msgs/msg/MarkerArray"]([
        kind(header(time_s), "m", i, 0, 0, pose(p), size, rgba, still, False, [], [], "", image,
             [], "", "", mesh, False)
        for i, p in enumerate(row, start=1)
    ])  # fmt: skip


def write_bag(path, session, form):
    """A bag in which nothing is recorded at the moment it was stamped."""
    names, messages = ["wrist", "base", "tilt"], []
    for t, angle, current in zip(
        session.servo_true_s, session.angle_rad, session.current_a, strict=True
    ):
        full, amps = np.append(9.0, angle), np.append(9.0, 1e3 * current)
        messages.append((t, "/joint_states", joint_state(t, full, amps, names)))
        messages.append((t, "/goals", joint_state(t, full, [], names)))
    for t, row in zip(session.mocap_s, session.markers_m, strict=False):
        if form == "MarkerArray":
            messages.append((t, "/markers", marker_array(t, row)))
        else:
            array = T["geometry_msgs/msg/PoseArray"](header(t), [pose(p) for p in row])
            messages.append((t, "/markers", array))
        tip = T["geometry_msgs/msg/PointStamped"](header(t), point(row[12:].mean(axis=0)))
        messages.append((t, "/tip", tip))
    with Writer(path, version=9) as bag:
        connections = {}
        for t, topic, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=STORE)
            recorded_ns = int((EPOCH_S + t) * 1e9) + 30_000_000
            bag.write(connections[topic], recorded_ns, STORE.serialize_cdr(message, kind))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("form", ["MarkerArray", "PoseArray"])
def test_a_bag_becomes_the_true_trial(session, write_map, run, check, tmp_path, form):
    bag = write_bag(tmp_path / "bag", session, form)
    tables = {"topics": TOPICS | {"/tip": "tip"}}
    if form == "MarkerArray":
        tables = {"topics": TOPICS, "markers": {f"m{i:02d}": f"m{i}" for i in range(1, 17)}}
    map_ = write_map(joints=["base", "tilt"], effort_unit="mA", **tables)
    code, _, err = run(bag, "--as", "rosbag", "--map", map_)
    assert code == 0, err
    check(tmp_path / "trials" / "bag.csv", session.first_s)


def test_wrong_bags_and_topics_are_refused_by_their_fault(session, write_map, refused, tmp_path):
    session.mocap_s = session.mocap_s[:20]
    write_bag(tmp_path / "bag", session, "PoseArray")
    (tmp_path / "empty").mkdir()
    joints = {"/joint_states": "joints"}
    units = {"joints": ["base", "tilt"], "effort_unit": "mA"}
    for bag, words, tables in (
        ("bag", "names no topics", {}),
        ("bag", "topic /js is missing; it has /goals, /joint", {"topics": {"/js": "joints"}}),
        ("bag", "cannot be read as 'tip'", {"topics": {"/joint_states": "tip"}}),
        ("bag", "has no joint 'elbow'", {"topics": joints, "joints": ["elbow"]}),
        ("bag", "nothing holds goal_1_rad", {"topics": joints} | units),
        ("empty", "is no readable ROS 2 bag", {"topics": TOPICS}),
    ):
        map_ = write_map(**tables)
        assert words in refused(tmp_path / bag, "--as", "rosbag", "--map", map_)
