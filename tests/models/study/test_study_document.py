"""Study document: written and read by one module, old files refused."""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from models.study.document import read_study, write_study
from models.study.study import run_study


def test_a_study_is_read_back_as_it_was_written(toy_study, tmp_path):
    write_study(tmp_path / "study.json", toy_study.document)
    assert read_study(tmp_path / "study.json") == toy_study.document


def test_a_study_of_another_version_is_refused_in_one_sentence(toy_study, tmp_path):
    path = tmp_path / "study.json"
    old = msgspec.to_builtins(toy_study.document) | {"schema": 1}
    path.write_text(json.dumps(old))
    with pytest.raises(InputError) as refused:
        read_study(path)
    message = str(refused.value)
    assert "schema version 1" in message and "dropstitch train" in message
    assert "\n" not in message


def test_one_payload_leaves_out_no_payload(toy_trials, toy_observer, tmp_path):
    """Keys of the cross-validation are absent, not null, where they do not apply."""
    training, _ = toy_trials(1).split()
    one = training.where(lambda t: t.meta.payload_kg == 1.0)
    write_study(tmp_path / "study.json", run_study(one, {}, toy_observer(1)).document)
    errors = json.loads((tmp_path / "study.json").read_text())["cross_validation"]["with_di"]["3"]
    assert set(errors) == {"blocks_m", "blocks_fold_std_m", "selection_m"}
    assert errors["selection_m"] == errors["blocks_m"]


def test_an_occluded_marker_row_is_null_in_the_poses(toy_trials, toy_observer, tmp_path):
    """All four markers of the first row hidden from the start: the document stays readable."""
    training, _ = toy_trials(1).split()
    hidden = [f"m{i:02d}_{axis}_m" for i in range(1, 5) for axis in "xyz"]
    blind = type(training)(
        tuple(
            replace(t, columns=t.columns | {n: _occluded(t.columns[n], t.meta) for n in hidden})
            for t in training
        )
    )
    path = tmp_path / "study.json"
    write_study(path, run_study(blind, {}, toy_observer(1)).document)
    poses = read_study(path).series.poses
    assert poses.centre_line_m[0][1] == (None, None, None)
    assert None not in poses.centre_line_m[0][2]


def _occluded(column, meta):
    """The column without the first moving row, where the first pose is taken."""
    column = column.copy()
    column[meta.rest_samples] = np.nan
    return column
