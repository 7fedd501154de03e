"""Ctrl-C during the imports of every command line."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
INTERRUPTED = """
import sys
class Pressed:
    def find_spec(name, path=None, target=None):
        if name == "firmware_py.core.console":
            raise {error}
sys.meta_path.insert(0, Pressed)
import {room}.__main__
"""
ROOMS = ("dropstitch", "hil")


def started(room, error):
    code = INTERRUPTED.format(room=room, error=error)
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("room", ROOMS)
def test_an_interruption_during_the_imports_is_one_sentence(room):
    ended = started(room, "KeyboardInterrupt")
    assert ended.stderr == "dropstitch: interrupted\n"
    assert ended.returncode in (-2, 130)  # Python ends itself by SIGINT: 130 in a shell


def test_any_other_error_is_shown_as_before():
    ended = started("dropstitch", "ZeroDivisionError")
    assert (ended.returncode, "Traceback" in ended.stderr) == (1, True)
