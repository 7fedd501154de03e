"""Null distributions that are measured again: each replaces its own, and keeps the others."""

import json

import msgspec
import pytest

from models.gap.search.null_distribution import KEY_ENDS, NullDistribution, null_distributions
from models.gap.training import plant_error

ROW = {"separations": {"creep": 3.0}, "left": 1.0, "named": [], "change": 0.3, "verdict": "no gap"}


@pytest.mark.parametrize(
    ("joints", "known", "key"),
    [
        (1, "patterns", "1"),
        (2, "patterns", "2"),
        (2, "curves", "2 without patterns"),
        (1, "nothing", "1 on other motions"),
    ],
)
def test_only_the_distribution_that_was_measured_changes(monkeypatch, tmp_path, joints, known, key):
    monkeypatch.setattr(plant_error, "NULL_DISTRIBUTION", tmp_path / "null_distribution.json")
    monkeypatch.setattr(plant_error, "_run", lambda job, work: run(job, work, tmp_path))
    plant_error.write_null_distribution([16, 17], [0, 1], str(tmp_path), joints, known)
    written = msgspec.json.decode(
        (tmp_path / "null_distribution.json").read_bytes(), type=dict[str, NullDistribution]
    )
    before = null_distributions()
    assert written[key].sets == 4
    pooled = before.get(key, before[str(joints)]).repetitions_pooled
    assert written[key].repetitions_pooled == pooled
    assert {k: v for k, v in written.items() if k != key} == {
        k: v for k, v in before.items() if k != key
    }


def run(job, work, directory):
    """Stand-in for the diagnoses: the file of each case."""
    assert job is plant_error.null_case and len(work) == 4
    for rig, link, _, joints, known in work:
        name = plant_error._null_file(str(directory), rig, link, joints, known)
        name.write_text(json.dumps(ROW))


def test_diagnoses_with_more_and_less_known_have_files_of_their_own():
    files = {
        plant_error._null_file("out", 16, 0, joints, known)
        for joints in (1, 2) for known in KEY_ENDS
    }  # fmt: skip
    assert len(files) == 8
