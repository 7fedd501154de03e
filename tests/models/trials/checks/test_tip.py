"""Tip beside the last marker row: named with what it is instead, and refused before any fit."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from models.shared.kinematics import base_rotation
from models.trials.checks.tip import judge_tip
from models.trials.checks.trials import refuse_unusable
from models.trials.files import write_trial


def with_tip(trial, tip_m):
    names = ("tip_x_m", "tip_y_m", "tip_z_m")
    return replace(trial, columns=trial.columns | dict(zip(names, np.array(tip_m).T, strict=True)))


def without_markers(trial, names=None):
    occluded = np.full(len(trial), np.nan)
    names = names or trial.meta.layout.names
    cells = {f"{name}_{axis}_m": occluded for name in names for axis in "xyz"}
    return replace(trial, columns=trial.columns | cells)


def pivot(trial, offset_m):
    """Tip at a point that is fixed on the last section."""
    return with_tip(trial, trial.tip_m + base_rotation(trial.angle_rad) @ np.array(offset_m))


WRONG = {
    "x is negated": lambda t: with_tip(t, t.tip_m * [-1, 1, 1]),
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
    (found,) = judge_tip(wrong)
    assert found.level == "refused" and words in found.text
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


@pytest.mark.parametrize(("occluded", "count"), [(("m14",), 1), (("m13", "m16"), 0)])
def test_the_last_row_is_compared_while_three_of_it_are_visible(trial, occluded, count):
    assert judge_tip(without_markers(trial, occluded)) == []
    wrong = judge_tip(without_markers(WRONG["x is negated"](trial), occluded))
    assert len(wrong) == count


def test_a_marker_elsewhere_is_not_taken_for_a_tip_elsewhere(trial):
    trial.columns["m13_x_m"][60:90] += 0.3
    assert judge_tip(trial) == []


@pytest.mark.parametrize(("markers", "jump_m"), [(True, 0.1), (False, 9.0)])
def test_one_wrong_sample_of_the_tip_is_only_a_warning(trial, markers, jump_m):
    trial.columns["tip_x_m"][150] += jump_m
    jump = trial if markers else without_markers(trial)
    (found,) = judge_tip(jump)
    assert found.level == "warning" and "row 152 (2.55 s)" in found.text
    refuse_unusable([jump])


def test_a_tip_that_is_wrong_in_a_part_of_the_run_is_refused(trial):
    trial.columns["tip_x_m"][150:200] += 0.05
    (found,) = judge_tip(trial)
    assert found.level == "refused" and "in 21% of the rows" in found.text


def test_without_markers_only_the_reach_is_known(trial):
    assert judge_tip(without_markers(WRONG["x is negated"](trial))) == []
    (found,) = judge_tip(without_markers(with_tip(trial, 39.37 * trial.tip_m)))
    assert "it is in inches" in found.text
    assert judge_tip(with_tip(trial, np.nan * trial.tip_m)) == []
    other = msgspec.structs.replace(trial.meta, link_length_m=0.0)  # of another plant
    assert judge_tip(replace(WRONG["x is negated"](trial), meta=other)) == []


@pytest.mark.parametrize("command", ["train", "identify", "evaluate"])
def test_commands_that_use_trials_refuse_a_wrong_tip(trial, tmp_path, capsys, command):
    write_trial(WRONG["x is negated"](trial), tmp_path / "trials")
    out = [] if command == "evaluate" else ["--out", str(tmp_path / "made.json")]
    dof = ["--dof", "1"] if command == "train" else []
    options = ["--plant", "models/plant/nominal.toml", *out, *dof]
    assert main([command, str(tmp_path / "trials"), *options]) == 2
    error = capsys.readouterr().err
    assert "run.csv: the tip is" in error and error.count("\n") == 1
