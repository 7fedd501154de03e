"""docs/safety.md and docs/safety/faults.md agree with the code."""

import ast

from hil.faults.fault_docs import FAULTS_PAGE, SAFETY_PAGE, faults_page, requirements, safety_page
from hil.faults.fault_table import ROWS
from tests.house.sources import ROOT, tree_of


def test_the_pages_are_generated_from_the_code():
    text = SAFETY_PAGE.read_text(encoding="utf-8")
    assert safety_page(text) == text, "run python -m hil.faults.fault_docs"
    assert faults_page() == FAULTS_PAGE.read_text(encoding="utf-8"), (
        "run python -m hil.faults.fault_docs"
    )


def test_every_requirement_has_tests_and_either_faults_or_a_reason_for_none():
    for requirement in requirements():
        assert requirement.tests, requirement.identifier
        assert bool(requirement.faults) != bool(requirement.no_fault), requirement.identifier
        for test in requirement.tests:
            file, _, name = test.partition("::")
            functions = [n for n in tree_of(ROOT / file).body if isinstance(n, ast.FunctionDef)]
            assert name in {function.name for function in functions}, test


def test_every_row_proves_a_requirement():
    known = {requirement.identifier for requirement in requirements()}
    for row in ROWS:
        assert row.proves and set(row.proves) <= known, f"{row.fault}, {row.how}: {row.proves}"
