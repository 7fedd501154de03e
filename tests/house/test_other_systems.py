"""Other systems than Linux: every module is imported there, every command says what it can do."""

from __future__ import annotations

import ast
import json
import subprocess
import sys

import pytest

from firmware_py.commands.command_table import COMMANDS
from tests.house.sources import ROOMS, ROOT, python_files, tree_of

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
    assert {line.split()[0] for line in windows["refusals"]} == {
        c.name for c in COMMANDS if c.linux_only
    }
    for line, (code, error) in windows["refusals"].items():
        assert (code, error.count("\n")) == (2, 1), line
        assert f"{line.split()[0]}: runs on Linux only, and this is Windows" in error


def as_text_without_encoding(node: ast.AST) -> bool:
    """Whether a call reads or writes text as this system encodes it, which differs on Windows."""
    if not isinstance(node, ast.Call) or any(k.arg == "encoding" for k in node.keywords):
        return False
    if isinstance(node.func, ast.Attribute):
        first = node.func.attr == "write_text"
        return node.func.attr in ("read_text", "write_text") and len(node.args) <= first
    if not (isinstance(node.func, ast.Name) and node.func.id == "open"):
        return False
    return len(node.args) < 2 or "b" not in ast.literal_eval(node.args[1])


def test_text_is_read_and_written_with_an_encoding():
    assert not [
        (path, node.lineno)
        for path in python_files(*ROOMS)
        for node in ast.walk(tree_of(path))
        if as_text_without_encoding(node)
    ]
