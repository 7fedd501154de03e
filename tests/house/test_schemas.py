"""Schemas: `docs/schema/` holds those of the documents as the code has them, and of every one."""

from __future__ import annotations

import ast
import json

import pytest

from hil.document_schemas import DOCUMENTS, main, schema_files
from tests.house.each_file import ROOT, tree_of

ROOMS = ("firmware_py", "models", "fmu", "hil")
REMEDY = "python -m hil.document_schemas docs/schema"


def written(directory):
    """Name of each file below a directory to its text."""
    files = [p for p in directory.rglob("*") if p.is_file()]
    return {p.relative_to(directory).as_posix(): p.read_text(encoding="utf-8") for p in files}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(schema_files()))
def test_a_schema_file_is_that_of_its_document(name):
    file = ROOT / "docs" / "schema" / name
    assert file.is_file() and file.read_text(encoding="utf-8") == schema_files()[name], REMEDY


def test_no_schema_file_is_left_over():
    assert written(ROOT / "docs" / "schema").keys() == schema_files().keys(), REMEDY


def bases_of_classes():
    """Class of the rooms to the names of its bases."""
    return {
        node.name: {b.id for b in node.bases if isinstance(b, ast.Name)}
        for room in ROOMS
        for path in (ROOT / room).rglob("*.py")
        for node in tree_of(path).body
        if isinstance(node, ast.ClassDef)
    }


def test_every_document_of_the_rooms_has_a_schema():
    bases, found = bases_of_classes(), {"Document"}
    while more := {name for name, of in bases.items() if of & found} - found:
        found |= more
    parents = {parent for name in found for parent in bases[name]}
    assert found - parents == {kind.__name__ for kind in DOCUMENTS.values()}


@pytest.mark.parametrize("kind", DOCUMENTS.values(), ids=lambda kind: kind.__name__)
def test_a_document_names_the_command_that_makes_it(kind):
    assert kind.MADE_BY.startswith(("python -m ", "dropstitch ")) and kind.VERSION >= 1


def test_the_command_writes_every_schema(tmp_path):
    assert main([str(tmp_path)]) == 0
    assert written(tmp_path) == schema_files()


def test_the_comment_of_a_field_is_its_description():
    """Beside the field, above it, and in a class that another one extends."""
    fields = json.loads(schema_files()["timing.schema.json"])["$defs"]["SilEnvironment"]
    described = {name: f.get("description", "") for name, f in fields["properties"].items()}
    assert "virtual" in described["line"]
    assert "plan" in described["goals_note"]
    assert "release" in described["kernel"]
