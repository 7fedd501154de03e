"""Goals against angles and conditions: still, cut, of another period or under another name."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.motion import KINDS, Motion
from models.trials.checks.goals import judge_goals
from models.trials.checks.trials import check_trial

REST, STEP_S = 60, 0.017
CAUSES = ("goal", "gap", "period", "motion", "amplitude")


@pytest.fixture
def run(make_trial):
    """Function (motion, seconds after its end) -> a trial whose servo lags and counts in steps."""

    def make(motion, after_s=0.0, **conditions):
        count = REST + round((motion.duration_s + after_s) / STEP_S)
        goal = motion.goal_rad(STEP_S * (np.arange(count) - REST))
        late = np.vstack([goal[:1], goal[:1], goal[:-2]])
        encoder_rad = 2 * np.pi / 4096
        conditions = {
            "motion": motion.name, "period_s": motion.period_s,
            "amplitude_rad": motion.amplitude_rad, "phase_2_rad": motion.phase_2_rad,
        } | conditions  # fmt: skip
        trial = make_trial(encoder_rad * np.round(late / encoder_rad), rest_samples=REST,
                           **conditions)  # fmt: skip
        for j, column in enumerate(goal.T, start=1):
            trial.columns[f"goal_{j}_rad"] = encoder_rad * np.round(column / encoder_rad)
        return trial

    return make


def told(trial):
    return [(f.level, f.cause) for f in check_trial(trial).findings if f.cause in CAUSES]


def without_rows(trial, first, count):
    """The trial without some rows, its times made even again."""
    columns = {n: np.delete(c, slice(first, first + count)) for n, c in trial.columns.items()}
    return replace(trial, columns=columns | {"time_s": trial.time_s[: len(trial) - count]})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("after_s", [0.0, 1.0, 4.0])
def test_right_goals_have_no_findings(run, kind, after_s):
    """Also where the return to zero, and a rest behind it, were recorded."""
    assert told(run(Motion(kind), after_s)) == []


def test_two_joints_apart_have_no_findings(run):
    assert told(run(Motion(dof=2, phase_2_rad=np.pi / 2), 1.0)) == []


@pytest.mark.parametrize("rows", [62, 90, 200, 320, 400])
def test_a_run_that_ended_early_has_no_findings(run, rows):
    whole = run(Motion())
    short = replace(whole, columns={n: c[:rows] for n, c in whole.columns.items()})
    assert judge_goals(short) == []


def test_an_angle_that_moves_without_its_goal_is_refused(run):
    trial = run(Motion())
    still = replace(trial, columns=trial.columns | {"goal_1_rad": np.zeros(len(trial))})
    (found,) = judge_goals(still)
    assert found.level == "refused" and "while goal_1_rad stands still" in found.text
    by_hand = replace(still, meta=msgspec.structs.replace(still.meta, amplitude_rad=0.0))
    assert told(by_hand) == []


def test_goals_that_do_not_reach_the_amplitude_at_all_are_told(run):
    trial = run(Motion())
    still = dict.fromkeys(("goal_1_rad", "angle_1_rad"), np.zeros(len(trial)))
    assert told(replace(trial, columns=trial.columns | still)) == [("warning", "amplitude")]


@pytest.mark.parametrize(("factor", "findings"), [(1.02, 1), (0.98, 1), (1.006, 1), (1.003, 0)])
@pytest.mark.parametrize("after_s", [0.0, 1.0, 4.0])
def test_a_wrong_time_base_is_told_by_the_period(run, factor, findings, after_s):
    trial = run(Motion(), after_s)
    wrong = replace(trial, columns=trial.columns | {"time_s": factor * trial.time_s})
    found = judge_goals(wrong)
    assert [f.cause for f in found] == findings * ["period"]
    assert all(f"{4.352 * factor:.3f} s, period_s says 4.352" in f.text for f in found)


@pytest.mark.parametrize(("first", "count"), [(200, 20), (330, 5)])
def test_rows_that_are_missing_are_told(run, first, count):
    """At speed, where goal and angle jump together."""
    (found,) = judge_goals(without_rows(run(Motion()), first, count))
    assert found.cause == "gap" and "rows are missing" in found.text
    assert any(f"row {row} " in found.text for row in range(first, first + 5))


def test_rows_that_are_missing_from_any_motion_are_told(run):
    assert told(without_rows(run(Motion("triangle")), 450, 40)) == [("warning", "gap")]


def test_a_sinusoid_under_another_name_is_told(run):
    trial = run(Motion())
    for name, findings in (("steps", [("warning", "motion")]), ("of mine", [])):
        assert told(replace(trial, meta=msgspec.structs.replace(trial.meta, motion=name))) == (
            findings
        )
