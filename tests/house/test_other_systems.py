"""Other systems than Linux: every module is imported there, every command says what it can do."""

import json
import subprocess
import sys

import pytest

from tests.house.sources import ROOT

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def windows():
    """What `emulated_windows` prints."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.house.emulated_windows"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_every_module_is_imported_on_windows(windows):
    assert windows["imports"] == {}


def test_every_command_has_help_on_windows(windows):
    assert len(windows["helps"]) > 20
    assert {c: error for c, (code, error) in windows["helps"].items() if code} == {}


def test_what_needs_linux_says_so_in_one_sentence(windows):
    assert windows["refusals"]
    for name, (code, error) in windows["refusals"].items():
        assert (code, error.count("\n")) == (2, 1), name
        assert f"{name}: runs on Linux only, and this is Windows" in error
