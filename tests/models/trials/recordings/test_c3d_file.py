import ezc3d
import numpy as np
import pytest

from models.trials.files import read_trial


def write_c3d(path, markers_m, *, unit="mm", labels=None, analogs=None):
    file = ezc3d.c3d()
    scale = {"mm": 1000.0, "m": 1.0}.get(unit, 1.0)
    points = np.ones((4, 16, len(markers_m)))
    points[:3] = scale * np.moveaxis(markers_m, -1, 0).transpose(0, 2, 1)
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


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_a_c3d_merged_with_a_servo_log_becomes_the_true_trial(
    session, servo_csv, write_map, run, check, tmp_path, unit
):
    log, columns = servo_csv
    markers_m = session.markers_m.copy()
    markers_m[400:420, 3] = np.nan
    file = write_c3d(tmp_path / "take.c3d", markers_m, unit=unit)
    map_ = write_map(session.dof, columns=columns)
    code, _, err = run(file, "--as", "c3d", "--servo", log, "--map", map_)
    assert code == 0, err
    trial = read_trial(tmp_path / "trials" / "take.csv")
    check(trial, session.servo_true_s[0], session.dof, 3e-4)
    gone = np.isnan(trial.markers_m).any(axis=2)
    assert gone.sum() == gone[:, 3].sum() == pytest.approx(20 / 240 / 0.017, abs=2)


def test_zeros_of_the_file_are_an_occlusion_wherever_its_origin_lies(
    session, servo_csv, write_map, run, tmp_path
):
    log, columns = servo_csv
    origin_m = np.array([0.1, -0.2, 0.42])
    in_file_m = session.markers_m + origin_m
    in_file_m[400:420, 12] = 0.0
    file = write_c3d(tmp_path / "take.c3d", in_file_m)
    map_ = write_map(session.dof, columns=columns, frame={"origin_m": origin_m.tolist()})
    code, _, err = run(file, "--as", "c3d", "--servo", log, "--map", map_)
    assert code == 0, err
    assert "exactly 0, 0, 0" in err and "m13 in 20 samples" in err
    trial = read_trial(tmp_path / "trials" / "take.csv")
    gone = np.isnan(trial.markers_m).any(axis=2)
    assert gone.sum() == gone[:, 12].sum() == pytest.approx(20 / 240 / 0.017, abs=2)
    assert np.abs(np.diff(trial.tip_m, axis=0)).max() < 0.05


def test_analog_channels_bring_angle_and_current_on_the_same_clock(
    session, write_map, run, check, tmp_path
):
    fine_s = np.arange(2 * len(session.mocap_s)) / 480
    analogs, columns = {}, {}
    for j in range(1, session.dof + 1):
        angle = np.interp(fine_s, session.servo_true_s, session.angle_rad[:, j - 1])
        analogs |= {f"A{j}": ("deg", np.degrees(angle)), f"C{j}": ("mA", 3000 * angle)}
        columns |= {
            f"angle_{j}_rad": {"from": f"A{j}"},
            f"goal_{j}_rad": {"from": f"A{j}"},
            f"current_{j}_a": {"from": f"C{j}", "unit": "mA"},
        }
    file = write_c3d(tmp_path / "take.c3d", session.markers_m, analogs=analogs)
    code, _, err = run(file, "--as", "c3d", "--map", write_map(session.dof, columns=columns))
    assert code == 0, err
    check(read_trial(tmp_path / "trials" / "take.csv"), 0.0, session.dof, 3e-4)


def test_wrong_files_get_one_sentence(session, write_map, refused, tmp_path):
    file = tmp_path / "take.c3d"
    map_ = write_map(session.dof)
    arguments = (file, "--as", "c3d", "--map", map_)
    file.write_bytes(b"no c3d at all" * 100)
    assert "is not C3D" in refused(*arguments)
    write_c3d(file, session.markers_m[:9], labels=[f"P{i}" for i in range(16)])
    assert "P0, P1" in refused(*arguments)
    write_c3d(file, session.markers_m[:9], unit="parsec")
    assert "POINT:UNITS is 'parsec'" in refused(*arguments)
    write_c3d(file, session.markers_m[:9])
    assert "nothing holds goal_1_rad" in refused(*arguments)
    assert "is missing" in refused(tmp_path / "none.c3d", "--as", "c3d", "--map", map_)
