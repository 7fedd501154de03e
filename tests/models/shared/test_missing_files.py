"""Work of many jobs that goes on where it was stopped."""

from functools import partial
from pathlib import Path

import pytest

from models.shared.missing_files import make_missing


def write(path):
    path.write_text("made")


def fail(path):
    raise ArithmeticError(f"no {path.name}")


def test_only_missing_files_are_made_and_failures_leave_the_others(tmp_path, capsys):
    there, new, bad = (tmp_path / "out" / name for name in ("there", "new", "bad"))
    there.parent.mkdir()
    there.write_text("before")
    jobs = {path: partial(write, path) for path in (there, new)} | {bad: partial(fail, bad)}
    assert make_missing("work", jobs, 1, tmp_path / "failures") == 1
    assert (there.read_text(), new.read_text()) == ("before", "made")
    assert "ArithmeticError: no bad" in (tmp_path / "failures" / "bad.txt").read_text()
    assert "work 2/2" in capsys.readouterr().err
    with pytest.raises(ArithmeticError):
        make_missing("work", jobs, 1)


def test_nothing_begins_if_nothing_is_missing():
    here = Path(__file__)
    assert make_missing("work", {here: partial(fail, here)}) == 0
