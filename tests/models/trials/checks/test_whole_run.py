"""Faults in the middle of a run: markers and encoders that are right at rest, and not later."""

from dataclasses import replace

import numpy as np
import pytest

from models.trials.checks.trials import check_trial

OF_THE_RUN = ("zeros", "held", "swapped", "place", "spike", "wrap", "phase")
ROWS = slice(60, 120)
"""Rows of the fault."""


@pytest.fixture
def trial(make_trial):
    """A rigid link that swings twice, 1 rad from end to end."""
    moving_s = np.maximum(0.017 * np.arange(240) - 0.34, 0.0)
    return make_trial(-0.5 * np.sin(np.pi * moving_s), period_s=2.0, rest_samples=20)


def told(trial):
    return [(f.cause, f.text) for f in check_trial(trial).findings if f.cause in OF_THE_RUN]


def marker(name):
    return [f"{name}_{axis}_m" for axis in "xyz"]


def changed(trial, columns):
    """The trial with other samples in `ROWS`."""
    result = {name: column.copy() for name, column in trial.columns.items()}
    for name, samples in columns.items():
        result[name][ROWS] = samples
    return replace(trial, columns=result)


def test_a_right_run_has_no_findings(trial):
    assert told(trial) == []


@pytest.mark.parametrize(
    "pair", [("m13", "m14"), ("m13", "m09"), ("m05", "m09"), ("m06", "m07"), ("m01", "m16")]
)
def test_exchanged_markers_are_named_with_their_rows(trial, pair):
    one, other = (marker(name) for name in pair)
    samples = {a: trial.columns[b][ROWS] for a, b in zip(one + other, other + one, strict=True)}
    ((cause, text),) = told(changed(trial, samples))
    assert cause == "swapped" and all(name in text for name in pair)
    assert "rows 62 to 121" in text  # the header is row 1


def test_zeros_are_an_occlusion(trial):
    ((cause, text),) = told(changed(trial, dict.fromkeys(marker("m13"), 0.0)))
    assert cause == "zeros" and "m13 in 60 samples" in text


def test_a_marker_elsewhere_is_out_of_place(trial):
    ((cause, text),) = told(changed(trial, {"m10_y_m": trial.columns["m10_y_m"][ROWS] + 0.08}))
    assert cause == "place" and "m10 is out of place" in text


def test_a_marker_that_jumps_again_and_again_is_told_once(trial):
    height_m = trial.columns["m10_z_m"].copy()
    height_m[60::9] += 0.1
    flickering = replace(trial, columns=trial.columns | {"m10_z_m": height_m})
    ((cause, text),) = told(flickering)
    assert cause == "place" and "in 20 of the rows 62 to 233" in text


@pytest.mark.parametrize("names", [("m07",), ("m13", "m14", "m15", "m16")])
def test_markers_that_stand_still_while_the_link_moves_are_told(trial, names):
    still = {c: trial.columns[c][ROWS.start] for name in names for c in marker(name)}
    found = told(changed(trial, still))
    assert [cause for cause, _ in found] == ["held"]
    assert all(name in found[0][1] for name in names)


def test_a_marker_that_nobody_saw_is_no_fault(trial):
    assert told(changed(trial, dict.fromkeys(marker("m13"), np.nan))) == []


def test_one_sample_that_no_joint_can_make_is_a_spike(trial):
    angle = trial.columns["angle_1_rad"].copy()
    angle[70] = 0.0
    ((cause, text),) = told(replace(trial, columns=trial.columns | {"angle_1_rad": angle}))
    assert cause == "spike" and "sample 71" in text


@pytest.mark.parametrize("wild_a", [99.0, -8.0, 4.0])
def test_one_sample_of_a_current_far_beyond_all_others_is_a_spike(trial, wild_a):
    noise_a = 0.05 * np.random.default_rng(0).standard_normal(len(trial))
    current = trial.columns["current_1_a"] + noise_a
    assert told(replace(trial, columns=trial.columns | {"current_1_a": current})) == []
    current[150] = wild_a
    ((cause, text),) = told(replace(trial, columns=trial.columns | {"current_1_a": current}))
    assert cause == "spike" and f"current_1_a jumps to {wild_a:g} A" in text
    assert "sample 151 (2.55 s)" in text


def test_friction_that_turns_round_and_the_kick_of_a_stepped_goal_are_no_spikes(trial):
    rate = np.gradient(trial.columns["angle_1_rad"])
    noise_a = 0.02 * np.random.default_rng(0).standard_normal(len(trial))
    current = 2.0 * np.sign(rate) + noise_a
    goal = np.where(np.arange(len(trial)) >= 100, 0.5, 0.0)
    stepped = trial.columns | {"goal_1_rad": goal, "angle_1_rad": 0 * goal}
    kick = noise_a.copy()
    kick[101] = 6.0
    for columns in (trial.columns | {"current_1_a": current}, stepped | {"current_1_a": kick}):
        assert "spike" not in [cause for cause, _ in told(replace(trial, columns=columns))]


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_signals_that_are_nothing_but_zeros_are_told_without_a_warning_of_numpy(trial):
    names = trial.meta.layout.names
    no_markers = {column: np.zeros(len(trial)) for name in names for column in marker(name)}
    for columns in (no_markers, {"angle_1_rad": np.zeros(len(trial))}):
        assert check_trial(replace(trial, columns=trial.columns | columns)).findings


def test_a_count_that_starts_again_is_refused_as_that(trial):
    columns = {n: trial.columns[n] % (2 * np.pi) for n in ("angle_1_rad", "goal_1_rad")}
    found = check_trial(replace(trial, columns=trial.columns | columns)).findings
    assert {f.cause for f in found if f.level == "refused"} == {"wrap"}


@pytest.mark.parametrize(("stated_rad", "findings"), [(np.pi / 2, []), (0.0, ["phase"])])
def test_a_phase_that_is_not_the_stated_one_is_told(make_trial, stated_rad, findings):
    turn = np.pi * np.maximum(0.017 * np.arange(240) - 0.34, 0.0)
    swing = -0.5 * np.column_stack([np.sin(turn), np.cos(turn) - 1])
    both = make_trial(swing, period_s=2.0, rest_samples=20, phase_2_rad=stated_rad)
    assert [cause for cause, _ in told(both)] == findings
