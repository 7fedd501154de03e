"""Steps, shared signals and clocks of the files of one take."""

import numpy as np
import pytest

from firmware_py.link.link_description import STUDY_LINK
from models.trials.checks.signals import judge_shared_signals
from models.trials.checks.times import judge_clock, judge_steps, judge_times
from models.trials.clock import ClockDrift, Synchronisation
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series
from models.trials.trial import TrialMeta

META = TrialMeta(
    dof=1, payload_kg=0.0, trial=1, motion="sinusoid", source="measured", period_s=4.0,
    rest_samples=1, **STUDY_LINK.conditions(),
)  # fmt: skip


def swing(time_s):
    """Rest, then two cycles of 4 s."""
    return -0.5 * np.sin(np.pi / 2 * np.clip(time_s - 1.0, 0, 8.0))


def servo_log(path, step_s=0.017):
    time_s = np.arange(0, 10, step_s)
    angle = swing(time_s)
    return Series(
        time_s, {"goal_1_rad": angle, "angle_1_rad": angle, "current_1_a": 3 * angle}, path
    )


@pytest.mark.parametrize(("step_s", "remedy"), [(0.017, None), (0.0015, None), (1 / 60, "0.01667")])
def test_another_step_is_named_with_the_remedy(step_s, remedy, tmp_path):
    log = [servo_log(tmp_path / "servo.csv", step_s)]
    found = judge_steps(log, RecordingMap())
    assert [f"step_s = {remedy}" in f.remedy for f in found] == [True] * bool(remedy)
    assert all(f.level == "warning" and "servo.csv" in f.text for f in found)
    assert judge_steps(log, RecordingMap(step_named=True)) == []


def test_a_step_that_jitters_is_not_taken_for_another(tmp_path):
    log = servo_log(tmp_path)
    jitter_s = np.random.default_rng(3).uniform(-0.002, 0.002, len(log.time_s))
    jittering = Series(log.time_s + jitter_s, log.columns, tmp_path)
    assert judge_steps([jittering], RecordingMap()) == []


@pytest.mark.parametrize(
    ("times", "words"),
    [(np.arange(50.0), "count frames"), (17.0 * np.arange(50), "unit"), (np.arange(50) / 60, "")],
)
def test_times_that_are_no_seconds_are_refused(times, words, tmp_path):
    found = judge_times([Series(times, {}, tmp_path / "take.csv")])
    assert [words in f.text for f in found] == [True] * bool(words)


@pytest.mark.parametrize(("factor", "count"), [(1.0, 0), (0.9, 1)])
def test_a_signal_of_both_files_is_named_where_they_differ(factor, count, tmp_path):
    servo = servo_log(tmp_path / "servo.csv")
    time_s = np.arange(0.1, 9.5, 1 / 120)
    mocap = Series(time_s, {"angle_1_rad": factor * swing(time_s)}, tmp_path / "mocap.csv")
    found = judge_shared_signals([servo], [mocap])
    assert ["angle_1_rad in servo.csv and in mocap.csv" in f.text for f in found] == [True] * count


@pytest.mark.parametrize(("change_s", "count"), [(0.0015, 0), (0.0025, 1), (-0.0025, 1)])
def test_a_drift_over_the_edges_of_a_signal_is_named(change_s, count):
    drift = ClockDrift(change_s, 2e-4, 7.8)
    clock = Synchronisation(1.0, np.nan, 5e-4, by="sync", drifts=(drift,))
    assert ["drift apart by 2.5" in f.text for f in judge_clock(clock)] == [True] * count
