"""Commands that `make gap-demo` would run: a hidden effect reaches the rig and nothing else."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from bench import demo

ROOT = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make")


def planned(target, *options):
    """Commands of ours that a target would run, with nothing built, whatever make runs the test."""
    done = subprocess.run(
        ["make", "--dry-run", "--always-make", "--directory", ROOT, target, *options],
        capture_output=True, text=True, check=True,
        env={k: v for k, v in os.environ.items() if k != "MAKEFLAGS"},
    )  # fmt: skip
    return re.findall(r'PATH="[^"]*" (dropstitch .*)', done.stdout)


@pytest.fixture(scope="module")
def commands():
    return planned("gap-demo", "HIDE=dead_time=0.03 creep=0.2")


def test_trials_and_runs_of_the_workflow_hide_the_effects_and_nothing_else_does(commands):
    hidden = "--hide dead_time=0.03 --hide creep=0.2"
    workflow = [c for c in commands if "build/gap_demo/" in c and "_without" not in c]
    for what in ("dropstitch simulate", "dropstitch sil", "report gap"):
        runs = [c for c in workflow if what in c]
        assert runs
        assert all(hidden in c for c in runs)
    blind = [
        c for c in commands if re.search(r"dropstitch (gap|train|identify|fmu )|sil_without", c)
    ]
    assert len(blind) > 10
    assert not any("--hide" in c for c in [*blind, *planned("build/report.html")])
    (report,) = [c for c in commands if "report gap" in c]
    assert "--out build/gap_demo/dead_time_0.03+creep_0.2/report.html" in report


@pytest.mark.parametrize(("stages", "report"), [
    (demo.DEMO, "build/report.html"), (demo.STUDY, "build/study/report.html"),
])  # fmt: skip
def test_the_stages_make_every_part_of_the_report(stages, report):
    """Except for its last stage, which writes the report and needs nothing else."""
    before = [target for stage in stages[:-1] for target in stage.targets.split()]
    assert stages[-1].targets == report
    assert {*planned(*before), planned(report)[-1]} == {*planned(report)}


def test_a_stage_that_fails_prints_its_output_and_ends_the_demo(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(demo, "BUILD", tmp_path)
    never = demo.Stage("never reached", "help", lambda: "")
    stages = (demo.Stage("make nothing", "no-such-target", lambda: ""), never)
    assert demo.run("demo", stages) != 0
    out = capsys.readouterr().out
    assert "no-such-target" in out and "never reached" not in out
