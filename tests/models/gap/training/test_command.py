"""The command of the training: both fitted files or none. No rig runs here: it would take hours."""

import json

import msgspec
import numpy as np
import pytest

from models.gap.decision import certainty
from models.gap.estimation import own_error
from models.gap.training import __main__ as command
from models.gap.training.case_runs import record_path
from tests.models.gap.training.records import made_record


@pytest.fixture
def shipped(monkeypatch, tmp_path):
    """Places of the fitted files."""
    places = {own_error: tmp_path / "own_error.npz", certainty: tmp_path / "certainty.json"}
    for module, path in places.items():
        path.write_text("before")
        monkeypatch.setattr(module, "PATH", path)
    return list(places.values())


@pytest.fixture
def runs(monkeypatch):
    """Stand-ins for what takes hours; the cases of each run with what it was given."""
    runs = []

    def measure(label, jobs, failures):
        for path in jobs:
            path.parent.mkdir(parents=True, exist_ok=True)
            rows = np.random.default_rng(len(path.name)).standard_normal((3, 1, 1, 40))
            np.savez(path, key_0=f"{path.parent.name[10]}dof sinusoid", payload_kg_0=[0.0],
                     signals_0=["di"], rows_0=rows, noise_0=np.ones((1, 40)))  # fmt: skip
        return 0

    def diagnose(cases, out, patterns):
        runs.append((cases, own_error.read_patterns(patterns)))
        for case in cases:
            path = record_path(out, case)
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(msgspec.json.encode(made_record(case)))
        return 0

    monkeypatch.setattr(command, "make_missing", measure)
    monkeypatch.setattr(command, "run_cases", diagnose)
    return runs


def test_both_files_are_made_and_say_what_made_them(shipped, runs, tmp_path, capsys):
    assert command.main(["--out", str(tmp_path / "out"), "--rigs", "8"]) == 0
    assert [p.key for p in own_error.read_patterns(shipped[0])] == [
        "1dof sinusoid",
        "2dof sinusoid",
    ]
    written = certainty.read_certainty() if shipped[1] == certainty.PATH else None
    assert set(written.separation_scale) == {"identified", "other motions", "other payloads"}
    assert {"python", "mujoco", "models", "own_error.npz"} <= set(written.made_with)
    ((_, patterns),) = runs
    assert len(patterns) == 2
    assert "log loss" in capsys.readouterr().out


def test_quick_writes_to_its_directory_alone(shipped, runs, tmp_path):
    assert command.main(["--out", str(tmp_path / "out"), "--quick"]) == 0
    assert [path.read_text() for path in shipped] == ["before", "before"]
    assert (tmp_path / "out" / "certainty.json").exists()
    assert sum(len(cases) for cases, *_ in runs) < 10


def test_nothing_is_replaced_if_a_job_fails(shipped, runs, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "run_cases", lambda *given: 1)
    assert command.main(["--out", str(tmp_path / "out"), "--rigs", "8"]) == 2
    assert [path.read_text() for path in shipped] == ["before", "before"]
    assert "failures: holds the errors" in capsys.readouterr().err


def test_work_of_other_versions_is_not_mixed_with_that_of_these(shipped, runs, tmp_path, capsys):
    (tmp_path / "made_with.json").write_text(json.dumps({"numpy": "1"}))
    assert command.main(["--out", str(tmp_path), "--quick"]) == 2
    assert "made_with.json: names other versions" in capsys.readouterr().err and not runs


def test_rigs_for_testing_are_refused(shipped, runs, tmp_path, capsys):
    assert command.main(["--out", str(tmp_path / "out"), "--rigs", "301"]) == 2
    assert "drawn_900: is not for tuning" in capsys.readouterr().err
