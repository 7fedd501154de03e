import ezc3d
import numpy as np
import pytest


def write_c3d(path, markers_m, *, unit="mm", labels=None, analogs=None):
    file = ezc3d.c3d()
    points = np.ones((4, 16, len(markers_m)))
    points[:3] = {"mm": 1000.0}.get(unit, 1.0) * np.moveaxis(markers_m, -1, 0).transpose(0, 2, 1)
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    file["parameters"]["POINT"]["RATE"]["value"] = [240.0]
    labels = labels or [f"m{i:02d}" for i in range(1, 17)]
    file["parameters"]["POINT"]["LABELS"]["value"] = labels
    file["data"]["points"] = points
    if analogs is not None:
        file["parameters"]["ANALOG"]["RATE"]["value"] = [480.0]
        file["parameters"]["ANALOG"]["LABELS"]["value"] = list(analogs)
        file["parameters"]["ANALOG"]["UNITS"]["value"] = [u for u, _ in analogs.values()]
        file["data"]["analogs"] = np.array([[v for _, v in analogs.values()]])
    file.write(str(path))
    return path


@pytest.mark.parametrize(("unit", "origin_m"), [("mm", [0.1, -0.2, 0.42]), ("m", [0.0, 0.0, 0.0])])
def test_c3d_with_a_servo_log_becomes_the_true_trial(
    session, servo_csv, write_map, run, check, tmp_path, unit, origin_m
):
    """Zeros of the file are an occlusion, wherever its origin lies."""
    log, columns = servo_csv
    in_file_m = session.markers_m + np.array(origin_m)
    in_file_m[400:420, 3] = np.nan
    in_file_m[600:620, 12] = 0.0
    file = write_c3d(tmp_path / "take.c3d", in_file_m, unit=unit)
    map_ = write_map(columns=columns, frame={"origin_m": origin_m})
    code, _, err = run(file, "--as", "c3d", "--servo", log, "--map", map_)
    assert code == 0, err
    assert "exactly 0, 0, 0" in err and "m13 in 20 samples" in err
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
