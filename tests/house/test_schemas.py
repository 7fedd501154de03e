"""Schemas: `docs/schema/` holds those of the documents as the code has them, and of every one."""

from __future__ import annotations

import ast
import json

import pytest

from hil.document_schemas import DOCUMENTS, main, schema_files
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


def test_the_comment_of_a_field_is_its_description():
    """Beside the field, above it, and in a class that another one extends."""
    fields = json.loads(schema_files()["timing.schema.json"])["$defs"]["SilEnvironment"]
    described = {name: f.get("description", "") for name, f in fields["properties"].items()}
    assert "virtual" in described["line"]
    assert "plan" in described["goals_note"]
    assert "release" in described["kernel"]
