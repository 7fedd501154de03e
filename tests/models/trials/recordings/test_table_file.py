"""Tables as text, JSON and MATLAB: columns by a map, by paths, and by the header of an export."""

import json

import numpy as np
import pytest
import scipy.io

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from models.plant.plant import read_plant
from models.trials.files import read_trial, write_trial
from models.trials.recordings.mapping import RecordingMap, read_mapping
from models.trials.recordings.table import json_values, read_table


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


def write_text(path, columns, delimiter=","):
    rows = zip(*columns.values(), strict=True)
    lines = [delimiter.join(columns), *(delimiter.join(map(repr, map(float, r))) for r in rows)]
    path.write_text("\n".join(lines))


def write_json(path, columns, form):
    lists = {k: v.tolist() for k, v in columns.items()}
    records = [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]
    forms = {"lists": lists, "records": records, "nested": {"motor": "x", "entries": records}}
    path.write_text(json.dumps(forms[form]))


@pytest.mark.slow
@pytest.mark.parametrize("form", ["csv", "tsv", "semicolon", "lists", "records", "nested", "mat"])
def test_every_form_of_a_table_becomes_the_true_trial(
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
    map_ = write_map(columns=mapping, step_s=0.02)
    code, _, err = run(file, "--as", "table", "--map", map_, "--name", "one")
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
        ({"angle_1_rad": {"from": "pos1", "unit": "rad"}}, "it is in deg"),
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
    map_ = write_map(servo_columns=columns)
    assert "under [columns] in MAP.toml; [servo_columns] is for that of --servo" in refused(
        log, "--as", "table", "--map", map_
    )


@pytest.mark.parametrize(
    ("tables", "what"),
    [
        ({"trial": {"payload_kg": "heavy"}}, "payload_kg"),
        ({"trial": {"colour": "blue"}}, "colour"),
        ({"colour": "blue"}, "colour"),
        ({"step_s": 0.0}, "step_s is 0.0"),
        ({"markers": {"m17": "x"}}, "'m17' is no marker"),
    ],
)
def test_a_wrong_map_is_refused_by_key(servo_csv, write_map, refused, tables, what):
    log, columns = servo_csv
    assert what in refused(log, "--as", "table", "--map", write_map(columns=columns, **tables))


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("a.json", "{", "is not JSON"),
        ("a.json", '{"note": "nothing"}', "holds no columns"),
        ("a.mat", "no matlab", "is not a MATLAB file"),
        ("a.csv", "a,b\n1,2\n3\n", "row 3 has 1 cells, the header 2"),
        ("a.csv", "", "holds no columns"),
        ("a.csv", "a,ms\n0,017,1,5\n", "decimal commas"),
        ("a.csv", "Taken by\tme\nt\tx\ty\n0.1\t1.5\t2.5\n", "rows that stand above the header"),
        ("a.csv", "ms,x\n10:00:01.5,1\n", "convert time stamps to seconds"),
    ],
)
def test_a_wrong_file_is_refused_by_its_fault(
    servo_csv, write_map, refused, tmp_path, name, content, what
):
    (tmp_path / name).write_text(content)
    map_ = write_map(columns=servo_csv[1])
    assert what in refused(tmp_path / name, "--as", "table", "--map", map_)


# --- paths in JSON --------------------------------------------------------------------------------

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
    ("path", "sentence"),
    [
        ("samples[].motor.positon", "samples[].motor holds no 'positon'; it has 'position'"),
        ("sample[].t", "the file holds no 'sample'; it has 'rig', 'samples'"),
        ("samples.t", "samples holds no 't'; it is a list of 3: write '[]'"),
        ("rig[].force", "rig holds no list; it has 'load', 'name'"),
        ("rig.name", "not lead to a list of single values"),
        ("samples[].motor.phases[]", "passes every entry of two lists"),
    ],
)
def test_a_wrong_path_is_refused_where_it_ends(tmp_path, path, sentence):
    with pytest.raises(InputError) as refused:
        json_values(tmp_path, NESTED, path)
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
    """Function (positions, forces, plant) -> exit code of the import of a nested log."""

    def call(place_mm, force_kn, plant=PLANT):
        (tmp_path / "plant.toml").write_text(plant)
        (tmp_path / "map.toml").write_text(PLANT_MAP)
        samples = [{"t_ms": 10.0 * k, "motor": {"position": p}} for k, p in enumerate(place_mm)]
        document = {"rig": {"mass_g": 250.0, "speed": 3}, "samples": samples}
        document["channels"] = {"force": list(force_kn)}
        (tmp_path / "log.json").write_text(json.dumps(document))
        command = ["import", str(tmp_path / "log.json"), "--as", "table", "--out", str(tmp_path)]
        return main([*command, "--map", str(tmp_path / "map.toml")])

    return call


def test_a_nested_log_of_a_plant_becomes_a_trial_with_the_names_of_the_plant(
    import_press, tmp_path
):
    place_mm, force_kn = np.sin(np.arange(50) / 8), np.cos(np.arange(50) / 8)
    assert import_press(place_mm.tolist(), force_kn.tolist()) == 0
    trial = read_trial(tmp_path / "log.csv", read_plant(tmp_path / "plant.toml").signals)
    assert "ram" in (tmp_path / "log.csv").read_text().partition("\n")[0]
    np.testing.assert_allclose(trial.columns["position_1_m"], 1e-3 * place_mm)
    np.testing.assert_allclose(trial.columns["force_1_n"], 1e3 * force_kn)
    assert trial.meta.conditions == {"mass_kg": 0.25} and trial.meta.motion == "3"


def test_a_plant_whose_signal_is_in_another_unit_than_its_quantity_is_refused(
    import_press, tmp_path, capsys
):
    """In millimetres the numbers would be taken as metres, and every mass come out too small."""
    assert import_press([0.0] * 5, [0.0] * 5, PLANT.replace('unit = "m",', 'unit = "mm",')) == 2
    sentence = capsys.readouterr().err
    assert "signal ram is given in 'mm', its quantity position_1_m in 'm'; give" in sentence
    assert not (tmp_path / "log.csv").exists()
    with pytest.raises(InputError, match="signal ram is given in 'mm'"):
        read_plant(tmp_path / "plant.toml")
    (tmp_path / "plant.toml").write_text(PLANT.replace('unit = "kg",', 'unit = "N",'))
    with pytest.raises(InputError, match=r"moved is given in 'N', parameter mass_kg in 'k"):
        read_plant(tmp_path / "plant.toml")


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
        "100\t100\t3\t2\tmm\t100",
        "Frame#\tTime\tLink A\t\t\tLink B\t\t",
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
        *([""] if form == "blank row" else []),
        *(row + tail for row in rows()),
    ]


@pytest.mark.parametrize(
    ("make", "form", "end"),
    [(qtm, "column header", "\n"), (qtm, "times", "\r\n"), (qtm, "positions only", "\n"),
     (trc, "", "\n"), (trc, "blank row", "\r\n"), (trc, "trailing tabs", "\n")],
)  # fmt: skip
def test_an_export_has_time_and_markers_by_their_names(make, form, end, tmp_path):
    path = tmp_path / "take.tsv"
    path.write_text(end.join(make(form)) + end, newline="")
    (series,) = read_table(path, MARKERS)
    assert series.time_s == pytest.approx([0.0, 0.01, 0.02])
    for k in range(2):
        assert series.position_m(f"m{k + 1:02d}") == pytest.approx(PLACES_MM[:, k] / 1e3)


def test_the_unit_of_a_trc_file_counts(tmp_path):
    path = tmp_path / "take.trc"
    path.write_text("\n".join(trc("")).replace("\tmm\t", "\tm\t"))
    (series,) = read_table(path, MARKERS)
    assert series.position_m("m02") == pytest.approx(PLACES_MM[:, 1])


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
