"""Faults within a run: markers, encoders and goals that are right at rest, and not later."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, Motion
from models.trials.checks.motion import judge_goals
from models.trials.checks.trials import check_trial, refuse_unusable

MARKERS = ("zeros", "held", "swapped", "place", "spike", "wrap")
GOALS = ("goal", "gap", "period", "motion", "amplitude", "phase")
ROWS = slice(60, 120)
"""Rows of the fault: 62 to 121 of a file with a header."""
REST, STEP_S = 60, 0.017


def changed(trial, **columns):
    return replace(trial, columns=trial.columns | columns)


def findings(trial, causes):
    return [f for f in check_trial(trial).findings if f.cause in causes]


def of_markers(trial, samples=None):
    """Cause and text of the findings on a trial with other samples in `ROWS`."""
    columns = {name: column.copy() for name, column in trial.columns.items()}
    for name, column in (samples or {}).items():
        columns[name][ROWS] = column
    return [(f.cause, f.text) for f in findings(replace(trial, columns=columns), MARKERS)]


def marker(name):
    return [f"{name}_{axis}_m" for axis in "xyz"]


# --- markers --------------------------------------------------------------------------------------


def test_a_right_run_has_no_findings(trial):
    assert of_markers(trial) == []
    assert of_markers(trial, dict.fromkeys(marker("m13"), np.nan)) == []  # occluded


@pytest.mark.parametrize("hidden", [0, 30])
@pytest.mark.parametrize("pair", [("m13", "m14"), ("m05", "m09"), ("m01", "m16")])
def test_exchanged_markers_are_named_with_their_rows(trial, pair, hidden):
    """Also if all were hidden for half a second before, while the link turned by 30 degrees."""
    one, other = (marker(name) for name in pair)
    samples = {
        a: trial.columns[b][ROWS].copy() for a, b in zip(one + other, other + one, strict=True)
    }
    for name in trial.meta.layout.names:
        for column in marker(name):
            trial.columns[column][ROWS.start - hidden : ROWS.start] = np.nan
    ((cause, text),) = of_markers(trial, samples)
    assert cause == "swapped"
    assert f"{pair[0]} and {pair[1]} are swapped in rows 62 to 121" in text


def test_zeros_are_an_occlusion(trial):
    ((cause, text),) = of_markers(trial, dict.fromkeys(marker("m13"), 0.0))
    assert cause == "zeros" and "m13 in 60 samples" in text


def test_a_marker_elsewhere_is_out_of_place_once(trial):
    ((cause, text),) = of_markers(trial, {"m10_y_m": trial.columns["m10_y_m"][ROWS] + 0.08})
    assert cause == "place" and "the place of m10 is wrong in rows 62 to 121" in text
    trial.columns["m10_z_m"][60::9] += 0.1  # again and again
    ((cause, text),) = of_markers(trial)
    assert cause == "place" and "in 20 of the rows 62 to 233" in text


@pytest.mark.parametrize("count", [1, 4, 16])
def test_markers_that_stand_still_while_the_link_moves_are_named(trial, count):
    names = trial.meta.layout.names[-count:]
    still = {c: trial.columns[c][ROWS.start] for name in names for c in marker(name)}
    ((cause, text),) = of_markers(trial, still)
    words = names if count < 16 else ["all markers"]
    assert cause == "held" and all(word in text for word in words) and "rows 62 to 121" in text


# --- encoder and current --------------------------------------------------------------------------


def test_one_sample_that_no_joint_can_make_is_a_spike(trial):
    trial.columns["angle_1_rad"][70] = 0.0
    ((cause, text),) = of_markers(trial)
    assert cause == "spike" and "sample 71" in text


@pytest.mark.parametrize("wild_a", [99.0, -8.0, 4.0])
def test_one_sample_of_a_current_far_beyond_all_others_is_a_spike(trial, wild_a):
    noise_a = 0.05 * np.random.default_rng(0).standard_normal(len(trial))
    current = trial.columns["current_1_a"] + noise_a
    assert of_markers(changed(trial, current_1_a=current)) == []
    current[150] = wild_a
    ((cause, text),) = of_markers(changed(trial, current_1_a=current))
    assert cause == "spike" and f"{wild_a:g} A" in text and "sample 151 (2.55 s)" in text


def test_reversed_friction_and_the_current_after_a_stepped_goal_are_no_spikes(trial):
    rate = np.gradient(trial.columns["angle_1_rad"])
    current = 0.02 * np.random.default_rng(0).standard_normal(len(trial))
    assert of_markers(changed(trial, current_1_a=current + 2.0 * np.sign(rate))) == []
    goal = np.where(np.arange(len(trial)) >= 100, 0.5, 0.0)
    current[101] = 6.0
    stepped = changed(trial, goal_1_rad=goal, angle_1_rad=0 * goal, current_1_a=current)
    assert of_markers(stepped) == []


def test_a_count_that_starts_again_is_refused_as_that(trial):
    columns = {n: trial.columns[n] % (2 * np.pi) for n in ("angle_1_rad", "goal_1_rad")}
    found = check_trial(changed(trial, **columns)).findings
    assert {f.cause for f in found if f.level == "refused"} == {"wrap"}


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_signals_of_zeros_do_not_make_numpy_warn(trial):
    zeros = np.zeros(len(trial))
    no_markers = dict.fromkeys([c for name in trial.meta.layout.names for c in marker(name)], zeros)
    for columns in (no_markers, {"angle_1_rad": zeros}):
        assert check_trial(changed(trial, **columns)).findings


# --- goals ----------------------------------------------------------------------------------------


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


def of_goals(trial, **conditions):
    trial = replace(trial, meta=msgspec.structs.replace(trial.meta, **conditions))
    return [(f.level, f.cause) for f in findings(trial, GOALS)]


@pytest.mark.parametrize("kind", KINDS)
def test_right_goals_have_no_findings(run, kind):
    for after_s in (0.0, 4.0):  # a rest after the return to zero may be recorded
        assert of_goals(run(Motion(kind), after_s)) == []


@pytest.mark.parametrize("rows", [62, 200, 400])
def test_a_run_that_ended_early_has_no_findings(run, rows):
    whole = run(Motion())
    short = replace(whole, columns={n: c[:rows] for n, c in whole.columns.items()})
    assert judge_goals(short) == []


def test_an_angle_that_moves_without_its_goal_or_mirrors_it_is_refused(run):
    trial = run(Motion())
    still = changed(trial, goal_1_rad=np.zeros(len(trial)))
    assert of_goals(still) == [("refused", "goal")]
    by_hand = replace(still, meta=msgspec.structs.replace(still.meta, amplitude_rad=0.0))
    assert of_goals(by_hand) == []
    refuse_unusable([trial, by_hand])
    mirrored = changed(trial, goal_1_rad=-trial.columns["goal_1_rad"])
    for wrong, words in ((still, "goal_1_rad stands still"), (mirrored, "sign of angle_1_rad")):
        with pytest.raises(InputError, match=words):
            refuse_unusable([wrong])


def test_goals_that_stand_still_are_compared_with_the_amplitude(run):
    still = np.zeros(len(trial := run(Motion())))
    trial = changed(trial, goal_1_rad=still, angle_1_rad=still)
    assert of_goals(trial) == [("warning", "amplitude")]


@pytest.mark.parametrize(("factor", "count"), [(0.98, 1), (1.006, 1), (1.003, 0)])
@pytest.mark.parametrize("after_s", [0.0, 4.0])
def test_a_wrong_time_step_is_a_wrong_period(run, factor, count, after_s):
    trial = run(Motion(), after_s)
    found = judge_goals(changed(trial, time_s=factor * trial.time_s))
    assert [f.cause for f in found] == count * ["period"]
    assert all(f"{4.352 * factor:.3f} s" in f.text for f in found)


@pytest.mark.parametrize(
    ("kind", "first", "count"), [("sinusoid", 200, 20), ("sinusoid", 330, 5), ("triangle", 450, 40)]
)
def test_missing_rows_are_named(run, kind, first, count):
    """The motion is fast there, so goal and angle jump together."""
    trial = run(Motion(kind))
    columns = {n: np.delete(c, slice(first, first + count)) for n, c in trial.columns.items()}
    cut = replace(trial, columns=columns | {"time_s": trial.time_s[:-count]})
    (found,) = judge_goals(cut)
    assert found.cause == "gap"
    assert any(f"row {row} " in found.text for row in range(first, first + 5))


def test_goals_of_another_motion_or_phase_are_named(run):
    assert of_goals(run(Motion()), motion="steps") == [("warning", "motion")]
    assert of_goals(run(Motion()), motion="of mine") == []
    ahead = run(Motion(dof=2, phase_2_rad=np.pi / 2), 1.0)
    assert of_goals(ahead) == []
    assert of_goals(ahead, phase_2_rad=0.0) == [("warning", "phase")]
