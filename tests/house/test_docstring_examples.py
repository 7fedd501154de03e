"""Examples of docstrings, run as they stand."""

from __future__ import annotations

import doctest
import importlib

import numpy as np
import pytest

from tests.house.sources import ROOMS, ROOT, python_files


def modules_with_examples() -> list[str]:
    files = [path for path in python_files(*ROOMS) if ">>> " in path.read_text(encoding="utf-8")]
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files]
    return [name.removesuffix(".__init__") for name in names]


@pytest.mark.parametrize("module", modules_with_examples())
def test_examples_give_what_they_show(module, tmp_path, monkeypatch):
    (tmp_path / "models").symlink_to(ROOT / "models")  # for the plant files that they read
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    output: list[str] = []
    with np.printoptions(precision=6, suppress=True):
        for test in doctest.DocTestFinder().find(importlib.import_module(module)):
            runner.run(test, out=output.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(output)
