"""Tip beside the last marker row: told with what it is instead, and refused before any fit."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.errors import InputError
from models.shared.kinematics import base_rotation
from models.trials.checks.tip import judge_tip
from models.trials.checks.trials import check_trial, refuse_unusable
from models.trials.files import write_trial

TIP = ("tip_x_m", "tip_y_m", "tip_z_m")
LAST_ROW = ("m13", "m14", "m15", "m16")


@pytest.fixture
def trial(make_trial):
    """A rigid link that swings twice, 1 rad from end to end."""
    moving_s = np.maximum(0.017 * np.arange(240) - 0.34, 0.0)
    angle = -0.5 * np.sin(np.pi * moving_s)
    return make_trial(angle, period_s=2.0, rest_samples=20)


def with_tip(trial, tip_m):
    return replace(trial, columns=trial.columns | dict(zip(TIP, np.array(tip_m).T, strict=True)))


def without_markers(trial, names=None):
    names = names or trial.meta.layout.names
    unseen = np.full(len(trial), np.nan)
    cells = {f"{name}_{axis}_m": unseen for name in names for axis in "xyz"}
    return replace(trial, columns=trial.columns | cells)


def pivot(trial, offset_m):
    """Tip at a point that is fixed on the last section."""
    return with_tip(trial, trial.tip_m + base_rotation(trial.angle_rad) @ np.array(offset_m))


WRONG = {
    "x is negated": lambda t: with_tip(t, t.tip_m * [-1, 1, 1]),
    "x and z are exchanged": lambda t: with_tip(t, t.tip_m[:, [2, 1, 0]]),
    "it is marker m01": lambda t: with_tip(t, t.markers_m[:, 0]),
    "no constant offset": lambda t: with_tip(t, t.tip_m * [0, 1, 1]),
    "dx, dy, dz = +0, +0, -300 mm in the frame of the world": lambda t: with_tip(
        t, t.tip_m - [0, 0, 0.3]
    ),
    "dx, dy, dz = +30, -20, +50 mm in the frame of the link": lambda t: pivot(
        t, (0.03, -0.02, 0.05)
    ),
    "it is in inches": lambda t: with_tip(t, 39.37 * t.tip_m),
}  # fmt: skip


def test_the_centre_of_the_last_row_is_right(trial):
    assert judge_tip(trial) == []


@pytest.mark.parametrize("words", WRONG)
def test_a_tip_elsewhere_is_refused_with_its_cause(trial, words):
    wrong = WRONG[words](trial)
    assert any(words in f.text and f.level == "refused" for f in check_trial(wrong).findings)
    with pytest.raises(InputError, match="the tip is"):
        refuse_unusable([wrong])


@pytest.mark.parametrize(
    ("offset_m", "levels"), [(0.004, []), (0.009, ["warning"]), (0.018, ["refused"])]
)
def test_limits_are_those_of_a_marker(trial, offset_m, levels):
    beside = pivot(trial, (0.0, offset_m, 0.0))
    assert [f.level for f in judge_tip(beside)] == levels
    if levels != ["refused"]:
        refuse_unusable([beside])


@pytest.mark.parametrize("unseen", [("m14",), ("m13", "m16"), LAST_ROW])
def test_a_row_that_is_partly_seen_does_not_mislead(trial, unseen):
    assert judge_tip(without_markers(trial, unseen)) == []
    wrong = judge_tip(without_markers(WRONG["x is negated"](trial), unseen))
    assert bool(wrong) == (len(unseen) == 1)


def test_a_marker_elsewhere_is_not_taken_for_a_tip_elsewhere(trial):
    columns = {"m13_x_m": trial.columns["m13_x_m"].copy()}
    columns["m13_x_m"][60:90] += 0.3
    assert judge_tip(replace(trial, columns=trial.columns | columns)) == []


@pytest.mark.parametrize("markers", [True, False])
@pytest.mark.parametrize("place_m", [9.0, 0.1])
def test_one_sample_of_the_tip_is_told_and_not_refused(trial, markers, place_m):
    tip_m = trial.tip_m.copy()
    tip_m[150, 0] += place_m
    jump = with_tip(trial if markers else without_markers(trial), tip_m)
    (found,) = judge_tip(jump)
    assert found.level == "warning" and "row 152 (2.55 s)" in found.text
    refuse_unusable([jump])


def test_a_tip_that_is_wrong_in_a_part_of_the_run_is_refused(trial):
    tip_m = trial.tip_m.copy()
    tip_m[150:200] += 0.05
    (found,) = judge_tip(with_tip(trial, tip_m))
    assert found.level == "refused" and "in 21% of the rows" in found.text


def test_without_markers_only_the_reach_is_known(trial):
    assert judge_tip(without_markers(trial)) == []
    (found,) = judge_tip(without_markers(with_tip(trial, 39.37 * trial.tip_m)))
    assert "it is in inches" in found.text
    assert judge_tip(without_markers(with_tip(trial, np.nan * trial.tip_m))) == []


def test_a_trial_of_another_plant_has_no_tip_to_compare(trial):
    other = msgspec.structs.replace(trial.meta, link_length_m=0.0)
    assert judge_tip(replace(WRONG["x is negated"](trial), meta=other)) == []


@pytest.mark.parametrize("command", ["train", "identify", "evaluate"])
def test_commands_that_use_trials_refuse_it(trial, tmp_path, capsys, command):
    write_trial(WRONG["x is negated"](trial), tmp_path / "trials")
    out = [] if command == "evaluate" else ["--out", str(tmp_path / "made.json")]
    dof = ["--dof", "1"] if command == "train" else []
    options = ["--plant", "models/plant/nominal.toml", *out, *dof]
    assert main([command, str(tmp_path / "trials"), *options]) == 2
    said = capsys.readouterr().err
    assert "run.csv: the tip is" in said and "x is negated" in said
    assert len(said.strip().splitlines()) == 1
