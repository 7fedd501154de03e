import json

import numpy as np
import pytest


def write_motive(path, time_s, markers_m, *, version="1.23", units="Meters", space="Global"):
    """A Motive export: y up, a rigid body in front, expected and measured markers, gaps blank."""
    per_metre = {"Meters": 1, "Centimeters": 100, "Millimeters": 1000}[units]
    body = ["Rigid Body"] * 8
    expected, measured = ["Rigid Body Marker"] * 64, ["Marker"] * 48
    names = [f"Link:M{i:02d}" for i in range(1, 17)]
    four = [n for n in names for _ in range(4)]
    three = [n for n in names for _ in range(3)]
    head = [
        ["Format Version", version, "Take Name", "Take 1", "Capture Frame Rate", "240.000000",
         "Rotation Type", "Quaternion", "Length Units", units, "Coordinate Space", space],
        [],
        ["", "Type", *body, *expected, *measured],
        ["", "Name", *["Link"] * 8, *four, *three],
        ["", "ID", *['"1"'] * 120],
        ["", "", *["Rotation"] * 4, *["Position"] * 3, "Error Per Marker",
         *[*["Position"] * 3, "Marker Quality"] * 16, *["Position"] * 48],
        ["Frame", "Time (Seconds)", "X", "Y", "Z", "W", "X", "Y", "Z", "",
         *["X", "Y", "Z", ""] * 16, *["X", "Y", "Z"] * 16],
    ]  # fmt: skip
    if version == "1.2":
        del head[4]  # the rows differ between versions: readers must not count lines
    else:
        head.insert(5, ["", "Parent", *[""] * 120])
    motive_m = per_metre * np.stack([markers_m[..., 0], markers_m[..., 2], -markers_m[..., 1]], -1)
    lines = [",".join(row) for row in head]
    for frame, (time, row) in enumerate(zip(time_s, motive_m, strict=True)):
        cells = [str(frame), f"{time:.6f}", *["0.1"] * 8]
        cells += [c for _ in range(16) for c in ("9", "9", "9", "1")]  # the solver's expectation
        cells += ["" if np.isnan(v) else f"{v:.7f}" for v in row.ravel()]
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def importing(servo_csv, write_map, run, tmp_path):
    """Function (file, tables of the map, options) -> result of an import with the servo's log."""
    log, columns = servo_csv

    def call(file, *options, **tables):
        map_ = write_map(columns=columns, **tables)
        return run(file, "--as", "motive", "--servo", log, "--map", map_, *options)

    return call


@pytest.mark.parametrize(
    ("version", "units"), [("1.23", "Meters"), ("1.2", "Millimeters"), ("1.25", "Centimeters")]
)
def test_export_with_a_servo_log_becomes_the_true_trial(
    session, importing, check, tmp_path, version, units
):
    file = write_motive(
        tmp_path / "take.csv", session.mocap_s, session.markers_m, version=version, units=units
    )
    code, out, err = importing(file, "--json")
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
    assert importing(write_motive(tmp_path / "take.csv", session.mocap_s, markers_m))[0] == 0
    trial = check(tmp_path / "trials" / "take.csv", session.first_s)
    gone = np.isnan(trial.markers_m[:, :, 0]).sum(axis=0)
    assert np.flatnonzero(gone).tolist() == [6, 12]
    assert gone[[6, 12]] == pytest.approx(np.array([30, 300]) / 240 / 0.017, abs=2)
    markers_m[300:312, 12:] = np.nan  # 50 ms
    assert importing(write_motive(tmp_path / "short.csv", session.mocap_s, markers_m))[0] == 0
    check(tmp_path / "trials" / "short.csv", session.first_s, 4e-3)
    markers_m[300:348, 12:] = np.nan  # 200 ms
    code, _, err = importing(write_motive(tmp_path / "long.csv", session.mocap_s, markers_m))
    assert code == 2 and "tip is unseen for 0.2" in err


def test_markers_are_mapped_by_name(session, importing, tmp_path, check):
    file = write_motive(tmp_path / "take.csv", session.mocap_s, session.markers_m)
    file.write_text(file.read_text().replace("Link:M", "Arm:Marker 0"))
    code, _, err = importing(file)
    assert code == 2 and "Arm:Marker 001" in err
    assert (
        importing(file, markers={f"m{i:02d}": f"Arm:Marker {i:03d}" for i in range(1, 17)})[0] == 0
    )
    check(tmp_path / "trials" / "take.csv", session.first_s)


@pytest.mark.parametrize(
    "frame", [{"align": "rest"}, {"yaw_deg": -130.0, "origin_m": [1.5, -0.4, 0.8]}]
)
def test_another_frame_is_turned_into_the_world_frame(frame, session, importing, tmp_path, check):
    yaw = np.radians(130)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    moved_m = session.markers_m @ turn.T + [1.5, -0.4, 0.8]
    file = write_motive(tmp_path / "take.csv", session.mocap_s, moved_m)
    code, _, err = importing(file, frame=frame)
    assert code == 0, err
    check(tmp_path / "trials" / "take.csv", session.first_s)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("Format Version", "Version", "is no Motive export"),
        ("Length Units,Meters", "Length Units,Feet", "Length Units is 'Feet'"),
        ("Space,Global", "Space,Local", "Coordinate Space is Local"),
        ("Frame,Time (Seconds)", "Frame,Time", "lacks"),
        (",Name,", ",Label,", "lacks its"),
        ("\nFrame,", "\nFrames,", "no row that begins with Frame"),
        ("\n0,0.000000,", "\n0,oops,", "column 'Time (Seconds)': 'oops' is not a number"),
        ("\n3,0.012500,", "\n3,0.001000,", "time does not increase after sample 3"),
        (",Position,", ",Rotation,", "0 columns for Y of m16"),
        (
            "Link:M02,Link:M02,Link:M02,Link:M03",
            "Link:M01,Link:M01,Link:M01,Link:M03",
            "2 columns for X of m01",
        ),
    ],
)
def test_a_damaged_export_is_refused_by_its_fault(
    session, write_map, refused, tmp_path, old, new, what
):
    file = write_motive(tmp_path / "take.csv", session.mocap_s[:9], session.markers_m[:9])
    head, _, tail = file.read_text().rpartition(old)  # the last one: of the measured markers
    assert tail
    file.write_text(head + new + tail)
    sentence = refused(file, "--as", "motive", "--map", write_map())
    assert what in sentence and "take.csv" in sentence


def test_a_truncated_export_is_refused(session, write_map, refused, tmp_path):
    file = write_motive(tmp_path / "take.csv", session.mocap_s[:9], session.markers_m[:9])
    file.write_text(file.read_text()[:-300])
    assert "truncated" in refused(file, "--as", "motive", "--map", write_map())
