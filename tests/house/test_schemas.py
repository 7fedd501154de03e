"""Schemas: `docs/schema/` holds those of the documents as the code has them, and of every one."""

import ast

import pytest

from hil.document_schemas import DOCUMENTS, main
from tests.house.sources import ROOMS, ROOT, python_files, tree_of

REMEDY = "python -m hil.document_schemas docs/schema"


def written(directory):
    """Name of each file below a directory to its text."""
    files = [p for p in directory.rglob("*") if p.is_file()]
    return {p.relative_to(directory).as_posix(): p.read_text(encoding="utf-8") for p in files}


@pytest.mark.slow
def test_the_schema_files_are_those_that_the_command_writes(tmp_path):
    assert main([str(tmp_path)]) == 0
    assert written(ROOT / "docs" / "schema") == written(tmp_path), REMEDY


def test_every_document_of_the_rooms_has_a_schema():
    bases = {
        node.name: {b.id for b in node.bases if isinstance(b, ast.Name)}
        for path in python_files(*ROOMS)
        for node in tree_of(path).body
        if isinstance(node, ast.ClassDef)
    }
    found = {"Document"}
    while more := {name for name, of in bases.items() if of & found} - found:
        found |= more
    parents = {parent for name in found for parent in bases[name]}
    assert found - parents == {kind.__name__ for kind in DOCUMENTS.values()}
