"""The command of the training. No rig runs here: it would take hours."""

import json

import msgspec
import pytest

from models.gap.decision import certainty
from models.gap.training import __main__ as command
from models.gap.training.case_runs import record_path
from tests.models.gap.training.records import made_record


@pytest.fixture
def shipped(monkeypatch, tmp_path):
    """Place of the fitted file."""
    path = tmp_path / "certainty.json"
    path.write_text("before")
    monkeypatch.setattr(certainty, "PATH", path)
    return path


@pytest.fixture
def runs(monkeypatch):
    """Stand-in for what takes hours; the cases of each run."""
    runs = []

    def diagnose(cases, out):
        runs.append(cases)
        for case in cases:
            path = record_path(out, case)
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(msgspec.json.encode(made_record(case)))
        return 0

    monkeypatch.setattr(command, "run_cases", diagnose)
    return runs


def test_the_file_is_made_and_says_what_made_it(shipped, runs, tmp_path, capsys):
    assert command.main(["--out", str(tmp_path / "out"), "--rigs", "8"]) == 0
    written = certainty.read_certainty()
    assert set(written.separation_scale) == {"identified", "other motions", "other payloads"}
    assert {"python", "mujoco", "models"} <= set(written.made_with)
    assert "log loss" in capsys.readouterr().out


def test_quick_writes_to_its_directory_alone(shipped, runs, tmp_path):
    assert command.main(["--out", str(tmp_path / "out"), "--quick"]) == 0
    assert shipped.read_text() == "before"
    assert (tmp_path / "out" / "certainty.json").exists()
    assert sum(map(len, runs)) < 10


def test_nothing_is_replaced_if_a_data_set_fails(shipped, runs, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "run_cases", lambda *given: 1)
    assert command.main(["--out", str(tmp_path / "out"), "--rigs", "8"]) == 2
    assert shipped.read_text() == "before"
    assert "failures: holds the errors" in capsys.readouterr().err


def test_work_of_other_versions_is_not_mixed_with_that_of_these(shipped, runs, tmp_path, capsys):
    (tmp_path / "made_with.json").write_text(json.dumps({"numpy": "1"}))
    assert command.main(["--out", str(tmp_path), "--quick"]) == 2
    assert "made_with.json: names other versions" in capsys.readouterr().err and not runs


@pytest.mark.slow
def test_rigs_for_testing_are_refused(shipped, runs, tmp_path, capsys):
    assert command.main(["--out", str(tmp_path / "out"), "--rigs", "301"]) == 2
    assert "drawn_900: is not for tuning" in capsys.readouterr().err
