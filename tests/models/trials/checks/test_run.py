"""Faults in the middle of a run: markers and encoders that are right at rest, and not later."""

from dataclasses import replace

import numpy as np
import pytest

from models.trials.checks.trials import check_trial

CAUSES = ("zeros", "held", "swapped", "place", "spike", "wrap")
ROWS = slice(60, 120)
"""Rows of the fault: 62 to 121 of a file with a header."""


def findings(trial, samples=None):
    """Findings on a trial with other samples in `ROWS`."""
    columns = {name: column.copy() for name, column in trial.columns.items()}
    for name, column in (samples or {}).items():
        columns[name][ROWS] = column
    found = check_trial(replace(trial, columns=columns)).findings
    return [(f.cause, f.text) for f in found if f.cause in CAUSES]


def changed(trial, **columns):
    return replace(trial, columns=trial.columns | columns)


def marker(name):
    return [f"{name}_{axis}_m" for axis in "xyz"]


def test_a_right_run_has_no_findings(trial):
    assert findings(trial) == []
    assert findings(trial, dict.fromkeys(marker("m13"), np.nan)) == []  # occluded


@pytest.mark.parametrize("pair", [("m13", "m14"), ("m05", "m09"), ("m06", "m07"), ("m01", "m16")])
def test_exchanged_markers_are_named_with_their_rows(trial, pair):
    one, other = (marker(name) for name in pair)
    samples = {a: trial.columns[b][ROWS] for a, b in zip(one + other, other + one, strict=True)}
    ((cause, text),) = findings(trial, samples)
    assert cause == "swapped"
    assert f"{pair[0]} and {pair[1]} are swapped in rows 62 to 121" in text


def test_markers_that_come_back_exchanged_from_an_occlusion_are_named(trial):
    """They were last visible half a second ago, and the link has turned by 30 degrees."""
    hidden = slice(ROWS.start - 30, ROWS.start)
    samples = {}
    for one, other in zip(marker("m13"), marker("m14"), strict=True):
        samples |= {one: trial.columns[other][ROWS], other: trial.columns[one][ROWS].copy()}
    for name in trial.meta.layout.names:
        for column in marker(name):
            trial.columns[column][hidden] = np.nan
    ((cause, text),) = findings(trial, samples)
    assert cause == "swapped" and "m13 and m14 are swapped in rows 62" in text


def test_zeros_are_an_occlusion(trial):
    ((cause, text),) = findings(trial, dict.fromkeys(marker("m13"), 0.0))
    assert cause == "zeros" and "m13 in 60 samples" in text


def test_a_marker_elsewhere_is_out_of_place(trial):
    ((cause, text),) = findings(trial, {"m10_y_m": trial.columns["m10_y_m"][ROWS] + 0.08})
    assert cause == "place" and "the place of m10 is wrong in rows 62 to 121" in text


def test_a_marker_that_jumps_again_and_again_is_one_finding(trial):
    trial.columns["m10_z_m"][60::9] += 0.1
    ((cause, text),) = findings(trial)
    assert cause == "place" and "in 20 of the rows 62 to 233" in text


@pytest.mark.parametrize("count", [1, 4, 16])
def test_markers_that_stand_still_while_the_link_moves_are_named(trial, count):
    names = trial.meta.layout.names[-count:]
    still = {c: trial.columns[c][ROWS.start] for name in names for c in marker(name)}
    ((cause, text),) = findings(trial, still)
    words = names if count < 16 else ["all markers"]
    assert cause == "held" and all(word in text for word in words) and "rows 62 to 121" in text


def test_one_sample_that_no_joint_can_make_is_a_spike(trial):
    trial.columns["angle_1_rad"][70] = 0.0
    ((cause, text),) = findings(trial)
    assert cause == "spike" and "sample 71" in text


@pytest.mark.parametrize("wild_a", [99.0, -8.0, 4.0])
def test_one_sample_of_a_current_far_beyond_all_others_is_a_spike(trial, wild_a):
    noise_a = 0.05 * np.random.default_rng(0).standard_normal(len(trial))
    current = trial.columns["current_1_a"] + noise_a
    assert findings(changed(trial, current_1_a=current)) == []
    current[150] = wild_a
    ((cause, text),) = findings(changed(trial, current_1_a=current))
    assert cause == "spike" and f"current_1_a jumps to {wild_a:g} A" in text
    assert "sample 151 (2.55 s)" in text


def test_reversed_friction_and_the_current_after_a_stepped_goal_are_no_spikes(trial):
    rate = np.gradient(trial.columns["angle_1_rad"])
    current = 0.02 * np.random.default_rng(0).standard_normal(len(trial))
    assert findings(changed(trial, current_1_a=current + 2.0 * np.sign(rate))) == []
    goal = np.where(np.arange(len(trial)) >= 100, 0.5, 0.0)
    current[101] = 6.0
    stepped = changed(trial, goal_1_rad=goal, angle_1_rad=0 * goal, current_1_a=current)
    assert findings(stepped) == []


def test_a_count_that_starts_again_is_refused_as_that(trial):
    columns = {n: trial.columns[n] % (2 * np.pi) for n in ("angle_1_rad", "goal_1_rad")}
    found = check_trial(changed(trial, **columns)).findings
    assert {f.cause for f in found if f.level == "refused"} == {"wrap"}


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_signals_of_zeros_do_not_make_numpy_warn(trial):
    zeros = np.zeros(len(trial))
    no_markers = dict.fromkeys(
        [column for name in trial.meta.layout.names for column in marker(name)], zeros
    )
    for columns in (no_markers, {"angle_1_rad": zeros}):
        assert check_trial(changed(trial, **columns)).findings
