"""Example programs: each runs from any directory and does what it says."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow


def run(name, *arguments, cwd):
    return subprocess.run(
        [sys.executable, ROOT / "examples" / f"{name}.py", *arguments],
        cwd=cwd, capture_output=True, text=True, timeout=600,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def test_predictions_are_read_from_the_running_loop(tmp_path):
    result = run("deploy_and_read_predictions", cwd=tmp_path)
    assert "tip x" in result.stdout, result.stderr
    assert "Traceback" not in result.stderr


def test_the_controller_holds_the_tip_of_the_twin(tmp_path):
    result = run("cosimulate_with_controller", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert float(result.stdout.split("at most ")[1].split()[0]) < 20.0  # mm


def test_the_verdict_on_the_timing_is_the_exit_code(tmp_path):
    result = run("sil_timing_in_ci", "--line", "virtual", "--seconds", "5", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "sil" / "timing.xml").is_file()
    assert run("sil_timing_in_ci", "--bundle", "none", cwd=tmp_path).returncode == 2


def test_recordings_become_a_bundle(tmp_path):
    result = run("own_mocap_to_bundle", tmp_path / "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "out" / "bundle" / "manifest.json").is_file()
