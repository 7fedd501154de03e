"""A toy module, its tests, and mutants of it: killed, surviving, hanging."""

import ast
import sys

import pytest

from tests.mutation.forked_runs import Run, ended_runs
from tests.mutation.mutants import draw, mutants

TOY = """
import sys


def clipped(value: int, most: int = 9) -> int:
    '''No more than 9.'''
    if value > most:
        raise ValueError(f"{value} is more than {most + 1}")
    return value


def countdown(count):
    while count > 0:
        count = count - 1
    return count


def untested(x):
    return x * 2.0
"""
TEST = """
import subprocess
import sys

import pytest

from toy_of_mutation import clipped, countdown


def test_toy():
    assert clipped(9) == 9
    with pytest.raises(ValueError):
        clipped(10)
    assert countdown(3) == 0
"""
IN_A_PROGRAM = """
import subprocess
import sys


def test_toy():
    text = "from toy_of_mutation import untested; assert untested(1.0) == 2.0"
    subprocess.run([sys.executable, "-c", text], check=True)
"""


@pytest.fixture
def toy(tmp_path):
    (tmp_path / "pytest.ini").write_text("[pytest]\npythonpath = .\nmarkers = slow\n")
    (tmp_path / "test_toy.py").write_text(TEST)
    path = tmp_path / "toy_of_mutation.py"
    path.write_text(TOY)
    return path


def results(path, chosen, limit_s=30.0):
    runs = [Run(("test_toy.py",), path.parent, limit_s, mutant) for mutant in chosen]
    return [end.result for end in ended_runs(runs, 2, lambda end: None)]


def chosen(path, old, new):
    return [m for m in mutants(path) if (m.old, m.new) == (old, new)]


@pytest.mark.slow
def test_a_mutant_is_killed_survives_or_hangs(toy):
    assert results(toy, [None]) == ["survived"]
    assert results(toy, chosen(toy, "value > most", "value >= most")) == ["killed"]
    assert results(toy, chosen(toy, "x * 2.0", "x / 2.0")) == ["survived"]
    assert results(toy, chosen(toy, "count - 1", "count + 1"), 3.0) == ["timeout"]
    assert "toy_of_mutation" not in sys.modules


@pytest.mark.slow
def test_a_program_that_a_test_starts_runs_the_mutant(toy):
    (toy.parent / "test_toy.py").write_text(IN_A_PROGRAM)
    assert results(toy, [None]) == ["survived"]
    assert results(toy, chosen(toy, "x * 2.0", "x / 2.0")) == ["killed"]


def test_every_mutant_differs_where_it_says_and_only_decisions_do(toy):
    lines = TOY.splitlines()
    for mutant in mutants(toy):
        mutated = mutant.source().decode()
        changed = [k for k, line in enumerate(mutated.splitlines(), 1) if line != lines[k - 1]]
        assert changed == [mutant.line]
        assert ast.unparse(ast.parse(mutated)) != ast.unparse(ast.parse(TOY))
    assert not chosen(toy, "most + 1", "most - 1")  # part of a message


def test_a_draw_does_not_depend_on_file_or_lines(toy):
    keys = [mutant.key for mutant in draw([toy], 6, seed=1)]
    moved = toy.with_name("moved.py")
    moved.write_text("FAR = 'away'\n" + TOY)
    assert [mutant.key for mutant in draw([moved], 6, seed=1)] == keys
    assert [mutant.key for mutant in draw([toy], 6, seed=2)] != keys
