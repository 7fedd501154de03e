"""Change one comparison, constant or operator of supervisor or signals: do its tests notice?

    python tests/firmware_py/safety/mutation.py          # every mutant, exit 1 where one survives
    python tests/firmware_py/safety/mutation.py OUT.json # and the two numbers in a file

A mutant is one module of supervisor or signal handling with one node of its syntax tree changed.
Each runs in a process forked from one that has everything imported, against the tests of supervisor
or signals until the first failure.
"""

from __future__ import annotations

import ast
import contextlib
import copy
import io
import json
import os
import sys
import types
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import hypothesis
import pytest

from firmware_py.console import Progress
from firmware_py.realtime import stop_signals
from firmware_py.safety import supervisor

HERE = Path(__file__).parent
TARGETS = {
    f"firmware_py.safety.{name}": Path(supervisor.__file__).with_name(f"{name}.py")
    for name in ("limits", "blend", "stop_reason", "supervisor")
}
TARGETS |= {stop_signals.__name__: Path(stop_signals.__file__)}
TESTS = [str(HERE / f"test_{name}.py") for name in ("limits", "blend", "supervisor")]
SIGNAL_TESTS = [str(HERE.with_name("test_stop_signals.py"))]

COMPARISONS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip

# A mutant needs no many examples: a single one that fails is enough.
hypothesis.settings.register_profile(
    "mutation", max_examples=8, database=None, deadline=None,
    phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate],
)  # fmt: skip


EQUIVALENT = {
    "_ROUNDING": "it only has to be larger than rounding and smaller than anything that matters",
    "self._hold_ticks = 0": "written before it is read, by every stop",
    "self._goal = [0.0] * dof": "written before it is read, by arm",
    "self._angle = [0.0] * dof": "written before it is read, by arm",
    "self._from_rest, self._tick, self._ticks = False, 0, 0": "there is no offset to blend",
    "self._anchor = [0.0] * dof": "written before it is read, by every way from rest",
    "self._offset = [0.0] * dof": "written before it is read, by absorb",
    "distance = 0.0": "a millirad takes no tick",
    "before, velocity = list(self._anchor)": "the room is wider than a rate of 1 mrad/s",
    "ticks += max(ticks // 4, 1)": "it says how finely durations are tried",
    "for tick, row in enumerate(rows, 1)": "the room is wider than what one tick changes",
    "while ticks < len(rows)": "what goes beyond is cut two lines later",
}
"""Lines whose mutants no test can tell from the original, and why."""


class Mutant(NamedTuple):
    module: str
    line: int
    change: str
    tree: ast.Module

    def __str__(self):
        return f"{self.module}, line {self.line}: {self.change}"


def constant(value):
    """Another constant of the same kind, as close as matters."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else value * 1.02 if value else 1e-3


def changed(node, field=None, k=None, new=None) -> str:
    before = ast.unparse(node)
    if k is None:
        setattr(node, field, new)
    else:
        getattr(node, field)[k] = new
    return f"{before}  →  {ast.unparse(node)}"


def places(tree):
    """Every (index of the node, field, index within it, new value)."""
    for n, node in enumerate(ast.walk(tree)):
        if isinstance(node, ast.Compare):
            for k, op in enumerate(node.ops):
                yield n, "ops", k, COMPARISONS[type(op)]()
        elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in OPERATORS:
            yield n, "op", None, OPERATORS[type(node.op)]()
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
            yield n, "value", None, constant(node.value)


def mutants(module: str) -> Iterator[Mutant]:
    """Every mutant of a module; what only talks (messages) is left alone."""
    source = TARGETS[module].read_text(encoding="utf-8")
    tree, lines = ast.parse(source), source.splitlines()
    talk = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            talk |= {id(child) for child in ast.walk(node)}
        elif isinstance(node, ast.ClassDef | ast.Call):  # strict=, frozen= and the like
            talk |= {id(word.value) for word in node.keywords if word.arg != "ends_hold"}
    nodes = list(ast.walk(tree))
    for n, field, k, new in places(tree):
        line = lines[getattr(nodes[n], "lineno", 1) - 1]
        if id(nodes[n]) in talk or any(text in line for text in EQUIVALENT):
            continue
        mutated = copy.deepcopy(tree)
        node = list(ast.walk(mutated))[n]
        change = changed(node, field, k, new)
        yield Mutant(module, node.lineno, change, ast.fix_missing_locations(mutated))


def survives(mutant: Mutant) -> bool:
    """Whether the tests pass with the mutant in place of the module."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1] == 0
    code = 1
    try:
        for name in TARGETS:  # what imports the mutant is imported anew
            del sys.modules[name]
        module = types.ModuleType(mutant.module)
        path = module.__file__ = str(TARGETS[mutant.module])
        sys.modules[mutant.module] = module
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            hypothesis.settings.load_profile("mutation")
            exec(compile(mutant.tree, path, "exec"), module.__dict__)
            tests = SIGNAL_TESTS if mutant.module == stop_signals.__name__ else TESTS
            code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "--no-header",
                                    "-p", "no:xdist", *tests]))  # fmt: skip
    finally:
        os._exit(0 if code == 0 else 1)
    return False


def survivors(step: int = 1, first: int = 0) -> tuple[int, list[Mutant]]:
    """How many mutants were tried, every `step`-th from `first` on, and which survived."""
    chosen = [mutant for module in TARGETS for mutant in mutants(module)][first::step]
    progress, alive = Progress("mutants", len(chosen)), []
    progress.begin("0 survive")
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for mutant, survived in zip(chosen, pool.map(survives, chosen), strict=True):
            alive += [mutant] if survived else []
            progress.step(f"{len(alive)} survive")
    return len(chosen), alive


if __name__ == "__main__":
    count, alive = survivors()
    print(f"{count} mutants, {len(alive)} survive")
    print("\n".join(map(str, alive)))
    for out in map(Path, sys.argv[1:]):
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps({"mutants": count, "survive": len(alive)}), encoding="utf-8")
    sys.exit(bool(alive))
