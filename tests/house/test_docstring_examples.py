"""Examples of docstrings, run as they stand."""

from __future__ import annotations

import ast
import doctest
import functools
import importlib

import numpy as np
import pytest

from tests.house.each_file import ROOT, tree_of

ROOMS = ("firmware_py", "models", "fmu", "hil")


@functools.cache
def modules_with_examples() -> list[str]:
    found = []
    for path in (p for room in ROOMS for p in sorted((ROOT / room).rglob("*.py"))):
        if ">>> " not in path.read_text(encoding="utf-8"):
            continue
        nodes = ast.walk(tree_of(path))
        documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        docstrings = (ast.get_docstring(n) or "" for n in nodes if isinstance(n, documented))
        if any(">>> " in d for d in docstrings):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found.append(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    return found


@functools.cache
def examples(module: str) -> list[doctest.DocTest]:
    found = doctest.DocTestFinder().find(importlib.import_module(module))
    return [test for test in found if test.examples]


@pytest.mark.parametrize("module", modules_with_examples())
def test_examples_give_what_they_show(module, tmp_path, monkeypatch):
    (tmp_path / "models").symlink_to(ROOT / "models")  # for the plant files that they read
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    output: list[str] = []
    with np.printoptions(precision=6, suppress=True):
        for test in examples(module):
            runner.run(test, out=output.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(output)
