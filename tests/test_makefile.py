"""Commands that `make gap-demo` would run: a hidden effect reaches the rig and nothing else."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

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
    assert not any("--hide" in c for c in [*blind, *planned("demo")])
    (report,) = [c for c in commands if "report gap" in c]
    assert "--out build/gap_demo/dead_time_0.03+creep_0.2/report.html" in report


def test_the_loop_in_software_runs_a_bundle_with_the_twin_of_its_plant():
    """Of the demo where that was run, else of one joint alone."""
    run = planned("sil")[-1]
    bundle, twin = re.search(r"--bundle (\S+) --fmu (\S+) ", run).groups()
    assert Path(bundle).parent == Path(twin).parent
