"""Requirements of docs/safety.md: each has a test or a fault, and each fault a requirement."""

import ast
from pathlib import Path

from hil.faults.fault_table import ROWS
from hil.faults.safety_requirements import REQUIREMENTS, rows_of

TESTS = Path(__file__).parents[2]
NAMES = [r.identifier for r in REQUIREMENTS]


def test_identifiers_are_unique_and_in_order():
    assert [f"SR-{k:02d}" for k in range(1, len(NAMES) + 1)] == NAMES


def test_what_verifies_a_requirement_is_there():
    for requirement in REQUIREMENTS:
        assert requirement.tests, requirement.identifier
        assert bool(requirement.faults) != bool(requirement.no_fault), requirement.identifier
        for test in requirement.tests:
            file, _, name = test.partition("::")
            tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
            assert name in {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}, test
        for pattern in requirement.faults:
            assert list(rows_of(requirement._replace(faults=(pattern,)))), pattern


def test_every_fault_verifies_something():
    assert {row.fault for row in ROWS} == {n for r in REQUIREMENTS for n in rows_of(r)}
