"""Rows are the servo's samples, goals belong to their samples, and bases align frames."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.link.link_description import STUDY_LINK
from models.trials.files import read_trial
from models.trials.recordings.assembly import assemble_trial, time_grid
from models.trials.recordings.frames import align_markers
from models.trials.recordings.mapping import BASE_MARKERS, MocapFrame, RecordingMap
from models.trials.recordings.series import Series, marker_columns
from tests.models.trials.recordings.conftest import CONDITIONS, angle_rad
from tests.models.trials.recordings.written_takes import WrittenTake, rigid_trial

STEP_S = 0.017
MAP = RecordingMap(trial=CONDITIONS | {"dof": 1, "motion": "other"})


# --- times of the rows ----------------------------------------------------------------------------


@pytest.mark.parametrize("mocap_first_s", [-0.4, 0.0095, 0.176])
def test_goals_and_angles_keep_their_samples_whatever_file_starts_first(mocap_first_s, tmp_path):
    rows = np.arange(100.0)
    servo = {"goal_1_rad": rows / 100, "angle_1_rad": np.sqrt(rows), "current_1_a": rows % 7}
    mocap_s = np.arange(mocap_first_s, 2.0, 1 / 240)
    tip = {f"tip_{axis}_m": np.sin(mocap_s) for axis in "xyz"}
    both = [Series(mocap_s, tip, tmp_path), Series(STEP_S * rows, servo, tmp_path)]
    trial = assemble_trial(both, MAP, "take")
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
    mocap = Series(tip_s, {f"tip_{axis}_m": tip_s for axis in "xyz"}, tmp_path)
    both = [mocap, Series(servo_s, servo, tmp_path)][2 - files :]
    trial = assemble_trial(both, MAP, "take")
    sent = np.interp(trial.angle_rad[:, 0], STEP_S * rows, rows) / 100  # the angle is the time
    assert np.abs(trial.goal_rad[:, 0] - sent).max() < 0.2 * 0.01 + 1e-9  # a fifth of a step


def test_the_phase_of_the_rows_is_that_in_which_goals_were_sent_or_sampled():
    log_s = np.arange(0, 3, 0.001)
    sent = np.floor((log_s - 0.0051) / STEP_S)  # logged finely
    grid_s, in_phase = time_grid(0.0123, 2.9, STEP_S, [(log_s, sent)])
    assert in_phase and (grid_s - 0.0051) % STEP_S == pytest.approx(0.0, abs=1e-3)
    log_s = np.delete(STEP_S * np.arange(100), 40)  # a lost sample
    grid_s, in_phase = time_grid(0.0, 99 * STEP_S, STEP_S, [(log_s, log_s)])
    assert in_phase and grid_s == pytest.approx(STEP_S * np.arange(100))
    log_s = 0.0031 + np.arange(0, 3, 0.01)  # another step
    grid_s, in_phase = time_grid(0.0123, 2.9, STEP_S, [(log_s, np.sin(log_s))])
    assert not in_phase and grid_s[0] == pytest.approx(0.0131)
    assert np.diff(grid_s) == pytest.approx(STEP_S)


def test_goals_are_held_and_never_mixed(tmp_path):
    time_s = STEP_S * np.arange(60)
    columns = {"goal_1_rad": np.where(time_s < 0.5, 0.0, 0.5), "angle_1_rad": time_s}
    series = Series(time_s, columns | {"current_1_a": time_s}, tmp_path)
    fine = RecordingMap(trial=MAP.trial, step_s=0.005)
    trial = assemble_trial([series], fine, "take")
    assert set(np.unique(trial.goal_rad)) == {0.0, 0.5}
    assert trial.time_s[np.argmax(trial.goal_rad[:, 0] > 0)] == pytest.approx(0.51, abs=0.005)


def test_a_time_since_an_epoch_keeps_its_step(make_trial, swing_rad, write_map, run, tmp_path):
    trial = make_trial(swing_rad)
    columns = trial.columns | {"time_s": trial.time_s + 1.7e9}
    lines = [",".join(map(repr, row)) for row in np.column_stack(list(columns.values())).tolist()]
    (tmp_path / "log.csv").write_text("\n".join([",".join(columns), *lines]))
    code, _, err = run(tmp_path / "log.csv", "--as", "table", "--map", write_map())
    assert code == 0, err
    back = read_trial(tmp_path / "trials" / "log.csv")
    assert len(back) == len(trial)
    assert np.diff(back.time_s) == pytest.approx(STEP_S, abs=2e-8)  # digits lost at both ends
    assert np.ptp(np.diff(back.time_s)) < 1e-12


# --- alignment ------------------------------------------------------------------------------------


def test_the_base_aligns_the_frame_and_keeps_the_prebend(rigid_markers, tmp_path):
    link_m = rigid_markers(np.zeros((30, 2)))
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
        mapping = RecordingMap(trial=MAP.trial, frame=MocapFrame(align=align))
        (aligned,) = align_markers([series], mapping)
        by[align] = np.stack([aligned.position_m(n)[0] for n in STUDY_LINK.layout.names])
    assert by["base"] == pytest.approx(bent_m[0], abs=1e-9)
    tip_x_m = by["rest"][12:, 0].mean()
    assert abs(tip_x_m) < 0.5 * bent_m[0, 12:, 0].mean()  # the prebend is laid on the axis


@pytest.mark.parametrize(("bent_m", "warned"), [(0.016, True), (0.004, False)])
def test_a_lean_that_the_rest_pose_removes_is_printed(bent_m, warned, tmp_path, capsys):
    trial = rigid_trial(angle_rad(0.017 * np.arange(300))[:, :1])
    for k, name in enumerate(STUDY_LINK.layout.names):
        height = trial.markers_m[0, k, 2] / 1.01
        trial.columns[f"{name}_x_m"] = trial.columns[f"{name}_x_m"] + bent_m * height**1.5
    arguments = WrittenTake(align="rest").write(trial, tmp_path, 1)
    out = ["--out", str(tmp_path / "trials")]
    assert main(["import", *arguments, *out, "--json"]) == 0
    printed, err = capsys.readouterr()
    document = json.loads(printed)
    assert document["removed_lean_tip_m"] == pytest.approx(bent_m, rel=0.4)
    assert "took away a lean of" in document["lean"]
    assert ("takes away a lean of" in err) == warned == (document["verdict"] == "warned")
    assert ("takes away a lean" in (tmp_path / "trials" / "take.html").read_text()) == warned
