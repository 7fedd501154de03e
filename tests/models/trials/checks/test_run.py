"""Faults within a run: markers, signals, tip and goals that are right at rest, and not later."""

from dataclasses import replace

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, Motion
from models.shared.kinematics import base_rotation
from models.trials.checks.motion import judge_goals
from models.trials.checks.tip import judge_tip
from models.trials.checks.trials import check_trial, refuse_unusable
from models.trials.files import write_trial
from tests.models.made_trials import with_columns, with_conditions

ROWS = slice(60, 120)
"""Rows of the fault: 62 to 121 of a file with a header."""
NAMES = [f"m{k:02d}" for k in range(1, 17)]


def cells(*markers):
    return [f"{name}_{axis}_m" for name in markers for axis in "xyz"]


def put(columns, value, rows=ROWS):
    """Trial with a value in the cells of some columns; a function gets what was there."""

    def change(trial):
        new = {name: trial.columns[name].copy() for name in columns}
        for column in new.values():
            column[rows] = value(column[rows]) if callable(value) else value
        return with_columns(trial, **new)

    return change


def exchanged(one, other, hidden=0):
    """Two markers in each other's place; before, all may have been hidden for some rows."""

    def change(trial):
        first, second = cells(one), cells(other)
        new = {name: trial.columns[name].copy() for name in cells(*NAMES)}
        for a, b in zip(first + second, second + first, strict=True):
            new[a][ROWS] = trial.columns[b][ROWS]
        for column in new.values():
            column[ROWS.start - hidden : ROWS.start] = np.nan
        return with_columns(trial, **new)

    return change


def still(*markers):
    return put(cells(*markers), lambda values: values[0])


def noisy_current(then=lambda trial: trial):
    """Trial whose current has noise, before another change."""

    def change(trial):
        noise_a = 0.05 * np.random.default_rng(0).standard_normal(len(trial))
        return then(with_columns(trial, current_1_a=trial.columns["current_1_a"] + noise_a))

    return change


def reversed_friction(trial):
    rate = np.gradient(trial.columns["angle_1_rad"])
    noise_a = 0.02 * np.random.default_rng(0).standard_normal(len(trial))
    return with_columns(trial, current_1_a=noise_a + 2.0 * np.sign(rate))


def stepped_goal(trial):
    current = 0.02 * np.random.default_rng(0).standard_normal(len(trial))
    current[101] = 6.0
    goal = np.where(np.arange(len(trial)) >= 100, 0.5, 0.0)
    return with_columns(trial, goal_1_rad=goal, angle_1_rad=0 * goal, current_1_a=current)


# --- markers, encoder and current -----------------------------------------------------------------

CAUSES = ("zeros", "held", "swapped", "place", "spike", "wrap")
FAULTS = {
    "exchanged": (exchanged("m13", "m14"), "swapped", "m13 and m14 are swapped in rows 62 to 121"),
    "rows exchanged": (exchanged("m05", "m09"), "swapped", "m05 and m09 are swapped in rows 62"),
    "ends exchanged": (exchanged("m01", "m16"), "swapped", "m01 and m16 are swapped in rows 62"),
    "exchanged while hidden": (
        # For half a second, in which the link turns by 30 degrees.
        exchanged("m13", "m14", hidden=30), "swapped", "m13 and m14 are swapped in rows 62",
    ),
    "zeros": (put(cells("m13"), 0.0), "zeros", "m13 in 60 samples"),
    "elsewhere": (
        put(["m10_y_m"], lambda v: v + 0.08), "place", "of m10 is wrong in rows 62 to 121",
    ),
    "jumps": (
        put(["m10_z_m"], lambda v: v + 0.1, slice(60, None, 9)), "place", "in 20 of the rows 62",
    ),
    "one stands": (still("m16"), "held", "m16"),
    "a row stands": (still(*NAMES[-4:]), "held", "m13, m14, m15 and m16"),
    "all stand": (still(*NAMES), "held", "all markers"),
    "angle jumps": (put(["angle_1_rad"], 0.0, 70), "spike", "sample 71"),
    "current far away": (noisy_current(put(["current_1_a"], 99.0, 150)), "spike", "99 A"),
    "current of the other sign": (noisy_current(put(["current_1_a"], -8.0, 150)), "spike", "-8 A"),
    "current twice the largest": (
        noisy_current(put(["current_1_a"], 4.0, 150)), "spike", "sample 151 (2.55 s)",
    ),
}  # fmt: skip
RIGHT = {
    "as it is": lambda trial: trial,
    "occluded": put(cells("m13"), np.nan),
    "noise": noisy_current(),
    "friction": reversed_friction,
    "stepped goal": stepped_goal,
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_within_a_run_is_named_once_with_its_rows(trial, name):
    change, cause, words = FAULTS[name]
    (finding,) = [f for f in check_trial(change(trial)).findings if f.cause in CAUSES]
    assert finding.cause == cause and words in finding.text


@pytest.mark.parametrize("name", RIGHT)
def test_a_right_run_has_no_findings(trial, name):
    found = check_trial(RIGHT[name](trial)).findings
    assert not [f for f in found if f.cause in CAUSES]


def test_a_count_that_starts_again_is_refused_as_that(trial):
    from_zero = put(["angle_1_rad", "goal_1_rad"], lambda v: v % (2 * np.pi), slice(None))
    refused = {f.cause for f in check_trial(from_zero(trial)).findings if f.level == "refused"}
    assert refused == {"wrap"}


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_signals_of_zeros_do_not_make_numpy_warn(trial):
    for columns in (cells(*NAMES), ["angle_1_rad"]):
        assert check_trial(put(columns, 0.0, slice(None))(trial)).findings


# --- tip ------------------------------------------------------------------------------------------


def with_tip(trial, tip_m):
    return with_columns(trial, **dict(zip(cells("tip"), np.array(tip_m).T, strict=True)))


def pivot(trial, offset_m):
    """Tip at a point that is fixed on the last section."""
    return with_tip(trial, trial.tip_m + base_rotation(trial.angle_rad) @ np.array(offset_m))


def negated(trial):
    return with_tip(trial, trial.tip_m * [-1, 1, 1])


def in_inches(trial):
    return with_tip(trial, 39.37 * trial.tip_m)


def without(*markers):
    return put(cells(*markers), np.nan, slice(None))


TIPS = {
    "x is negated": negated,
    "it is marker m01": lambda t: with_tip(t, t.markers_m[:, 0]),
    "no constant offset": lambda t: with_tip(t, t.tip_m * [0, 1, 1]),
    "+0, +0, -300 mm in the frame of the world": lambda t: with_tip(t, t.tip_m - [0, 0, 0.3]),
    "+30, -20, +50 mm in the frame of the link": lambda t: pivot(t, (0.03, -0.02, 0.05)),
    "it is in inches": in_inches,
    "in 21% of the rows": put(["tip_x_m"], lambda v: v + 0.05, slice(150, 200)),
}


@pytest.mark.parametrize("words", TIPS)
def test_a_tip_beside_the_last_marker_row_is_refused_with_its_cause(trial, words):
    wrong = TIPS[words](trial)
    (found,) = judge_tip(wrong)
    assert found.level == "refused" and words in found.text
    with pytest.raises(InputError, match="the tip is"):
        refuse_unusable([wrong])


@pytest.mark.parametrize(
    ("change", "levels"),
    [
        (lambda t: t, []),
        (lambda t: pivot(t, (0.0, 0.004, 0.0)), []),
        (lambda t: pivot(t, (0.0, 0.009, 0.0)), ["warning"]),
        (lambda t: pivot(t, (0.0, 0.018, 0.0)), ["refused"]),
        (without("m14"), []),
        (lambda t: without("m14")(negated(t)), ["refused"]),  # three of the row are visible
        (lambda t: without("m13", "m16")(negated(t)), []),
        (put(["m13_x_m"], lambda v: v + 0.3, slice(60, 90)), []),
        (put(["tip_x_m"], lambda v: v + 0.1, 150), ["warning"]),
        (lambda t: without(*NAMES)(put(["tip_x_m"], lambda v: v + 9.0, 150)(t)), ["warning"]),
        (lambda t: without(*NAMES)(negated(t)), []),  # only the reach is known
        (lambda t: without(*NAMES)(in_inches(t)), ["refused"]),
        (lambda t: with_tip(t, np.nan * t.tip_m), []),
        (lambda t: with_conditions(negated(t), link_length_m=0.0), []),  # of another plant
    ],
)
def test_a_tip_is_compared_where_the_last_row_shows_it(trial, change, levels):
    other = change(trial)
    assert [f.level for f in judge_tip(other)] == levels
    if levels != ["refused"]:
        refuse_unusable([other])


@pytest.mark.parametrize("command", ["train", "identify", "evaluate"])
def test_commands_that_use_trials_refuse_a_wrong_tip(trial, tmp_path, capsys, command):
    write_trial(negated(trial), tmp_path / "trials")
    out = [] if command == "evaluate" else ["--out", str(tmp_path / "made.json")]
    dof = ["--dof", "1"] if command == "train" else []
    options = ["--plant", "models/plant/nominal.toml", *out, *dof]
    assert main([command, str(tmp_path / "trials"), *options]) == 2
    error = capsys.readouterr().err
    assert "run.csv: the tip is" in error and error.count("\n") == 1


# --- goals ----------------------------------------------------------------------------------------

REST, STEP_S = 60, 0.017


@pytest.fixture
def run(make_trial):
    """Function (motion, seconds after its end) -> a trial whose servo lags and counts in steps."""

    def make(motion, after_s=0.0):
        count = REST + round((motion.duration_s + after_s) / STEP_S)
        goal = motion.goal_rad(STEP_S * (np.arange(count) - REST))
        late = np.vstack([goal[:1], goal[:1], goal[:-2]])
        encoder_rad = 2 * np.pi / 4096
        trial = make_trial(
            encoder_rad * np.round(late / encoder_rad), rest_samples=REST, motion=motion.kind,
            period_s=motion.period_s, amplitude_rad=motion.amplitude_rad,
            phase_2_rad=motion.phase_2_rad,
        )  # fmt: skip
        for j, column in enumerate(goal.T, start=1):
            trial.columns[f"goal_{j}_rad"] = encoder_rad * np.round(column / encoder_rad)
        return trial

    return make


def of_goals(trial):
    causes = ("goal", "gap", "period", "motion", "amplitude", "phase")
    return [(f.level, f.cause) for f in check_trial(trial).findings if f.cause in causes]


@pytest.mark.parametrize("kind", KINDS)
def test_right_goals_have_no_findings(run, kind):
    for after_s in (0.0, 4.0):  # a rest after the return to zero may be recorded
        assert of_goals(run(Motion(kind), after_s)) == []


def test_a_run_that_ended_early_has_no_findings(run):
    whole = run(Motion())
    for rows in (62, 200, 400):
        short = replace(whole, columns={n: c[:rows] for n, c in whole.columns.items()})
        assert judge_goals(short) == []


def test_goals_that_contradict_angles_or_conditions_are_named(run):
    trial, ahead = run(Motion()), run(Motion(dof=2, phase_2_rad=np.pi / 2), 1.0)
    still = with_columns(trial, goal_1_rad=0 * trial.time_s)
    assert of_goals(still) == [("refused", "goal")]
    assert of_goals(with_conditions(still, amplitude_rad=0.0)) == []  # moved by hand
    assert of_goals(with_columns(still, angle_1_rad=0 * trial.time_s)) == [("warning", "amplitude")]
    assert of_goals(with_conditions(trial, motion="steps")) == [("warning", "motion")]
    assert of_goals(with_conditions(trial, motion="of mine")) == of_goals(ahead) == []
    assert of_goals(with_conditions(ahead, phase_2_rad=0.0)) == [("warning", "phase")]
    mirrored = with_columns(trial, goal_1_rad=-trial.columns["goal_1_rad"])
    for wrong, words in ((still, "goal_1_rad stands still"), (mirrored, "sign of angle_1_rad")):
        with pytest.raises(InputError, match=words):
            refuse_unusable([wrong])


@pytest.mark.parametrize(("factor", "count"), [(0.98, 1), (1.006, 1), (1.003, 0)])
@pytest.mark.parametrize("after_s", [0.0, 4.0])
def test_a_wrong_time_step_is_a_wrong_period(run, factor, count, after_s):
    trial = run(Motion(), after_s)
    found = judge_goals(with_columns(trial, time_s=factor * trial.time_s))
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
