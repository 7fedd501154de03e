"""Examples of docstrings, run as they stand."""

import doctest
import functools
import importlib

import numpy as np
import pytest

import dropstitch
from tests.house.sources import ROOMS, ROOT, python_files

SLOW = {
    "models.bundle.train", "models.gap.diagnosis", "models.gap.report.gap_json",
    "models.gap.report.gap_results", "models.gap.report.gap_words", "models.plan.plan",
    "models.plant.identification.identify", "models.trials.importing",
}  # fmt: skip
"""Modules whose examples simulate, fit or diagnose for seconds."""


def modules_with_examples():
    files = [path for path in python_files(*ROOMS) if ">>> " in path.read_text(encoding="utf-8")]
    dotted = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files]
    names = [name.removesuffix(".__init__") for name in dotted]
    return [pytest.param(n, marks=pytest.mark.slow if n in SLOW else ()) for n in names]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Directory of an example, with the files of the checkout that it reads."""
    (tmp_path / "models").symlink_to(ROOT / "models")
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def of_diagnose():
    """Function that gives what the example of `diagnose` leaves behind; it is run once."""

    @functools.cache
    def names() -> dict[str, object]:
        (example,) = doctest.DocTestFinder(recurse=False).find(dropstitch.diagnose, "diagnose")
        code = compile("".join(part.source for part in example.examples), "diagnose", "exec")
        exec(code, example.globs)
        return example.globs

    return names


@pytest.mark.parametrize("module", modules_with_examples())
def test_examples_give_what_they_show(module, place, of_diagnose):
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    output: list[str] = []
    with np.printoptions(precision=6, suppress=True):
        for test in doctest.DocTestFinder().find(importlib.import_module(module)):
            if "`diagnosis` in the example" in (test.docstring or ""):
                test.globs |= of_diagnose()
            runner.run(test, out=output.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(output)
