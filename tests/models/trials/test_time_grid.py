"""Rows of a trial lie on the servo's samples, whatever file starts first."""

import numpy as np
import pytest

from models.trials.recordings.assembly import assemble_trial, time_grid
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series

STEP_S = 0.017
META = {
    "dof": 1, "payload_kg": 1.0, "pressure_pa": 41300.0, "trial": 1, "motion": "own",
    "period_s": 1.0, "amplitude_rad": 0.5, "base_offset_m": 0.06, "link_length_m": 0.95,
    "link_width_m": 0.15,
}  # fmt: skip


@pytest.mark.parametrize("mocap_first_s", [-0.4, 0.0, 0.0075, 0.0095, 0.176])
def test_goals_and_angles_keep_their_samples_whatever_file_starts_first(mocap_first_s, tmp_path):
    rows = np.arange(100.0)
    servo = {"goal_1_rad": rows / 100, "angle_1_rad": np.sqrt(rows), "current_1_a": rows % 7}
    mocap_s = np.arange(mocap_first_s, 2.0, 1 / 240)
    tip = {f"tip_{axis}_m": np.sin(mocap_s) for axis in "xyz"}
    both = [Series(mocap_s, tip, tmp_path), Series(STEP_S * rows, servo, tmp_path)]
    trial = assemble_trial(both, RecordingMap(trial=META), "take")
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
    trial = assemble_trial(both, RecordingMap(trial=META), "take")
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
