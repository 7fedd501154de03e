"""Rows lie on the servo's samples, goals belong to their samples, and bases align frames."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.link.link_description import STUDY_LINK
from models.trials.files import read_trial
from models.trials.pipeline import align_markers
from models.trials.recordings.assembly import assemble_trial, time_grid
from models.trials.recordings.mapping import BASE_MARKERS, MocapFrame, RecordingMap
from models.trials.recordings.series import Series, marker_columns
from tests.models.trials.recordings.conftest import angle_rad
from tests.models.trials.recordings.test_wrong_imports import rigid_trial
from tests.models.trials.recordings.written_takes import WrittenTake

META = {
    "dof": 1, "payload_kg": 1.0, "pressure_pa": 41300.0, "trial": 1, "motion": "step",
    "period_s": 1.0, "amplitude_rad": 0.5, "base_offset_m": 0.06, "link_length_m": 0.95,
    "link_width_m": 0.15,
}  # fmt: skip


@pytest.mark.parametrize("late_s", [0.0, 0.002, 0.010, 0.016])
def test_a_goal_within_a_period_after_a_sample_belongs_to_its_row(late_s, tmp_path):
    sampled_s = 0.017 * np.arange(40)
    goals = np.arange(40) / 100
    measured = Series(sampled_s, {"angle_1_rad": goals, "current_1_a": goals}, tmp_path)
    sent = Series(sampled_s + late_s, {"goal_1_rad": goals}, tmp_path)
    trial = assemble_trial([measured, sent], RecordingMap(trial=META), "take")
    row = np.round(trial.angle_rad[:, 0] * 100).astype(int)
    kept = slice(0, -1)
    assert np.round(trial.goal_rad[kept, 0] * 100).astype(int).tolist() == row[kept].tolist()


def test_a_time_since_an_epoch_keeps_its_step(make_trial, swing_rad, write_map, run, tmp_path):
    trial = make_trial(swing_rad)
    columns = {"time_s": trial.time_s + 1.7e9} | {
        name: values for name, values in trial.columns.items() if name != "time_s"
    }
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(repr(float(v)) for v in row) for row in rows)]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    code, _, err = run(tmp_path / "log.csv", "--as", "table", "--map", write_map(2))
    assert code == 0, err
    back = read_trial(tmp_path / "trials" / "log.csv")
    assert np.diff(back.time_s) == pytest.approx(0.017, abs=2e-8)  # digits lost at both ends
    assert np.ptp(np.diff(back.time_s)) < 1e-12
    assert len(back) == len(trial)


def test_the_base_aligns_the_frame_and_keeps_the_prebend(rigid_markers, tmp_path):
    still = np.zeros((30, 2))
    link_m = rigid_markers(still)
    bent_m = link_m + np.multiply.outer((link_m[..., 2] - 0.06) ** 2, [0.02, 0, 0])
    base_m = np.broadcast_to(
        [(sx * 0.075, sy * 0.075, 0.06) for sy in (1, -1) for sx in (1, -1)], (30, 4, 3)
    )
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    named = {n: bent_m[:, k] for k, n in enumerate(STUDY_LINK.layout.names)}
    named |= {n: base_m[:, k] for k, n in enumerate(BASE_MARKERS)}
    moved = {n: p @ turn.T + [0.3, 0.2, 0.42] for n, p in named.items()}
    series = Series(np.arange(30) / 120, marker_columns(moved), tmp_path)
    by = {}
    for align in ("base", "rest"):
        mapping = RecordingMap(trial=META, frame=MocapFrame(align=align))
        (aligned,) = align_markers([series], mapping)
        by[align] = np.stack([aligned.position_m(n)[0] for n in STUDY_LINK.layout.names])
    assert by["base"] == pytest.approx(bent_m[0], abs=1e-9)
    tip_x_m = by["rest"][12:, 0].mean()
    assert abs(tip_x_m) < 0.5 * bent_m[0, 12:, 0].mean()  # the prebend is laid on the axis


@pytest.mark.parametrize(("bent_m", "warned"), [(0.016, True), (0.004, False)])
def test_a_lean_that_the_rest_pose_takes_away_is_said(
    bent_m, warned, rigid_markers, tmp_path, capsys
):
    trial = rigid_trial(angle_rad(0.017 * np.arange(300), 1))
    for k, name in enumerate(STUDY_LINK.layout.names):
        height = trial.markers_m[0, k, 2] / 1.01
        trial.columns[f"{name}_x_m"] = trial.columns[f"{name}_x_m"] + bent_m * height**1.5
    arguments = WrittenTake(align="rest").write(trial, tmp_path, 1)
    out = ["--out", str(tmp_path / "trials")]
    assert main(["import", *arguments, *out, "--json"]) == 0
    printed, err = capsys.readouterr()
    document = json.loads(printed)
    assert document["removed_lean_tip_m"] == pytest.approx(bent_m, rel=0.4)
    assert ("takes away a lean of" in err) == warned == (document["verdict"] == "warned")
    assert ("takes away a lean" in (tmp_path / "trials" / "take.html").read_text()) == warned
    assert main(["import", *arguments, *out]) == 0
    assert "took away a lean of" in capsys.readouterr().out


STEP_S = 0.017
OWN_MOTION = META | {"motion": "own"}


@pytest.mark.parametrize("mocap_first_s", [-0.4, 0.0, 0.0075, 0.0095, 0.176])
def test_goals_and_angles_keep_their_samples_whatever_file_starts_first(mocap_first_s, tmp_path):
    rows = np.arange(100.0)
    servo = {"goal_1_rad": rows / 100, "angle_1_rad": np.sqrt(rows), "current_1_a": rows % 7}
    mocap_s = np.arange(mocap_first_s, 2.0, 1 / 240)
    tip = {f"tip_{axis}_m": np.sin(mocap_s) for axis in "xyz"}
    both = [Series(mocap_s, tip, tmp_path), Series(STEP_S * rows, servo, tmp_path)]
    trial = assemble_trial(both, RecordingMap(trial=OWN_MOTION), "take")
    first = max(int(np.ceil(mocap_first_s / STEP_S)), 0)
    assert len(trial) == 100 - first
    for name, values in servo.items():
        assert trial.columns[name].tobytes() == values[first:].tobytes(), name
    assert trial.tip_m[:, 0] == pytest.approx(np.sin(STEP_S * rows[first:]), abs=1e-5)


@pytest.mark.parametrize("files", [1, 2])
def test_goals_belong_to_samples_that_jitter(files, tmp_path):
    rng = np.random.default_rng(2)
    rows = np.arange(200.0)
    servo_s = STEP_S * rows + rng.uniform(-0.003, 0.003, 200)
    servo = {"goal_1_rad": rows / 100, "angle_1_rad": servo_s, "current_1_a": rows}
    tip_s = np.arange(0.0905, 3.0, 1 / 240)
    mocap = Series(tip_s, {"tip_x_m": 0 * tip_s, "tip_y_m": 0 * tip_s, "tip_z_m": tip_s}, tmp_path)
    both = [mocap, Series(servo_s, servo, tmp_path)][2 - files :]
    trial = assemble_trial(both, RecordingMap(trial=OWN_MOTION), "take")
    sent = np.interp(trial.angle_rad[:, 0], STEP_S * rows, rows) / 100  # the angle tells the time
    assert np.abs(trial.goal_rad[:, 0] - sent).max() < 0.2 * 0.01 + 1e-9  # a fifth of a step


def test_a_finely_logged_goal_gives_the_phase_in_which_it_was_sent():
    log_s = np.arange(0, 3, 0.001)
    sent = np.floor((log_s - 0.0051) / STEP_S)
    grid = time_grid(0.0123, 2.9, STEP_S, [(log_s, sent)])
    assert grid.in_phase
    assert (grid.time_s - 0.0051) % STEP_S == pytest.approx(0.0, abs=1e-3)


def test_another_step_begins_on_a_sample():
    log_s = 0.0031 + np.arange(0, 3, 0.01)
    grid = time_grid(0.0123, 2.9, STEP_S, [(log_s, np.sin(log_s))])
    assert not grid.in_phase
    assert grid.time_s[0] == pytest.approx(0.0131)
    assert np.diff(grid.time_s) == pytest.approx(STEP_S)


def test_a_lost_sample_leaves_the_grid_where_it_was():
    log_s = np.delete(STEP_S * np.arange(100), 40)
    grid = time_grid(0.0, 99 * STEP_S, STEP_S, [(log_s, log_s)])
    assert grid.in_phase
    assert grid.time_s == pytest.approx(STEP_S * np.arange(100))
