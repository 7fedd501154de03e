"""A document of another version is refused in one sentence with the command that makes it anew."""

from __future__ import annotations

import json
import shutil

import pytest

from dropstitch.__main__ import main as dropstitch
from firmware_py.core.console import BAD_INPUT
from firmware_py.core.documents import read_document, write_document
from firmware_py.core.errors import InputError
from hil.document_schemas import DOCUMENTS
from models.plant.plant import read_plant
from tests.firmware_py.goals.small_plan import small_plan


@pytest.mark.parametrize("kind", DOCUMENTS.values(), ids=lambda kind: kind.__name__)
def test_each_kind_refuses_another_version_and_a_missing_field(tmp_path, kind):
    path = tmp_path / "old.json"
    for content in ({"schema": kind.VERSION - 1}, {"schema": kind.VERSION}, {}):
        path.write_text(json.dumps(content))
        with pytest.raises(InputError) as refused:
            read_document(path, kind)
        text = str(refused.value)
        assert text.startswith(f"{path}: ") and "\n" not in text and kind.MADE_BY in text


@pytest.mark.parametrize(
    ("file", "field", "command", "made_by"),
    [
        ("bundle/manifest.json", "content_sha256", "goalmap", "dropstitch train"),
        ("plan.json", "link", "plan plan.json --improve run.mcap", "plan"),
        ("plant.json", "schema", "goalmap", "identify"),
    ],
)
def test_a_command_refuses_an_old_file(
    tmp_path, bare_bundle, capsys, monkeypatch, file, field, command, made_by
):
    monkeypatch.chdir(tmp_path)
    bundle = shutil.copytree(bare_bundle, tmp_path / "bundle")
    write_document(tmp_path / "plan.json", small_plan(bundle))
    read_plant().write(tmp_path / "plant.json")
    document = json.loads((tmp_path / file).read_text())
    del document[field]
    (tmp_path / file).write_text(json.dumps(document))
    argv = [*command.split(), "--plant", "plant.json", "--bundle", "bundle", "--out", "out.json"]
    assert dropstitch(argv) == BAD_INPUT
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and file in error and made_by in error and field in error
