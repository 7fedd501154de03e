"""Goals against angles and conditions: still, cut, of another period or under another name."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.core.motion import KINDS, Motion
from models.trials.checks.motion import judge_goals
from models.trials.checks.trials import check_trial

REST, STEP_S = 60, 0.017
CAUSES = ("goal", "gap", "period", "motion", "amplitude", "phase")


@pytest.fixture
def run(make_trial):
    """Function (motion, seconds after its end) -> a trial whose servo lags and counts in steps."""

    def make(motion, after_s=0.0):
        count = REST + round((motion.duration_s + after_s) / STEP_S)
        goal = motion.goal_rad(STEP_S * (np.arange(count) - REST))
        late = np.vstack([goal[:1], goal[:1], goal[:-2]])
        encoder_rad = 2 * np.pi / 4096
        trial = make_trial(
            encoder_rad * np.round(late / encoder_rad), rest_samples=REST, motion=motion.name,
            period_s=motion.period_s, amplitude_rad=motion.amplitude_rad,
            phase_2_rad=motion.phase_2_rad,
        )  # fmt: skip
        for j, column in enumerate(goal.T, start=1):
            trial.columns[f"goal_{j}_rad"] = encoder_rad * np.round(column / encoder_rad)
        return trial

    return make


def findings(trial, **conditions):
    trial = replace(trial, meta=msgspec.structs.replace(trial.meta, **conditions))
    return [(f.level, f.cause) for f in check_trial(trial).findings if f.cause in CAUSES]


def changed(trial, **columns):
    return replace(trial, columns=trial.columns | columns)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("after_s", [0.0, 4.0])
def test_right_goals_have_no_findings(run, kind, after_s):
    """Also where a rest after the return to zero was recorded."""
    assert findings(run(Motion(kind), after_s)) == []


@pytest.mark.parametrize("rows", [62, 200, 320, 400])
def test_a_run_that_ended_early_has_no_findings(run, rows):
    whole = run(Motion())
    short = replace(whole, columns={n: c[:rows] for n, c in whole.columns.items()})
    assert judge_goals(short) == []


def test_an_angle_that_moves_without_its_goal_is_refused(run):
    still = changed(trial := run(Motion()), goal_1_rad=np.zeros(len(trial)))
    (found,) = judge_goals(still)
    assert found.level == "refused" and "while goal_1_rad stands still" in found.text
    assert findings(still, amplitude_rad=0.0) == []  # moved by hand


def test_goals_that_stand_still_are_compared_with_the_amplitude(run):
    still = np.zeros(len(trial := run(Motion())))
    trial = changed(trial, goal_1_rad=still, angle_1_rad=still)
    assert findings(trial) == [("warning", "amplitude")]


@pytest.mark.parametrize(("factor", "count"), [(1.02, 1), (0.98, 1), (1.006, 1), (1.003, 0)])
@pytest.mark.parametrize("after_s", [0.0, 4.0])
def test_a_wrong_time_step_is_a_wrong_period(run, factor, count, after_s):
    trial = run(Motion(), after_s)
    found = judge_goals(changed(trial, time_s=factor * trial.time_s))
    assert [f.cause for f in found] == count * ["period"]
    assert all(f"{4.352 * factor:.3f} s, period_s says 4.352" in f.text for f in found)


@pytest.mark.parametrize(
    ("kind", "first", "count"), [("sinusoid", 200, 20), ("sinusoid", 330, 5), ("triangle", 450, 40)]
)
def test_missing_rows_are_named(run, kind, first, count):
    """The motion is fast there, so goal and angle jump together."""
    trial = run(Motion(kind))
    columns = {n: np.delete(c, slice(first, first + count)) for n, c in trial.columns.items()}
    cut = replace(trial, columns=columns | {"time_s": trial.time_s[:-count]})
    (found,) = judge_goals(cut)
    assert found.cause == "gap" and "rows are missing" in found.text
    assert any(f"row {row} " in found.text for row in range(first, first + 5))


@pytest.mark.parametrize(("name", "count"), [("steps", 1), ("of mine", 0)])
def test_a_sinusoid_under_another_name_is_named(run, name, count):
    assert findings(run(Motion()), motion=name) == [("warning", "motion")] * count


@pytest.mark.parametrize(("stated_rad", "count"), [(np.pi / 2, 0), (0.0, 1)])
def test_a_wrong_phase_of_the_second_joint_is_named(run, stated_rad, count):
    trial = run(Motion(dof=2, phase_2_rad=np.pi / 2), 1.0)
    assert findings(trial, phase_2_rad=stated_rad) == [("warning", "phase")] * count
