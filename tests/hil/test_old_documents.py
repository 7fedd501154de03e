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


def without(path, *keys):
    """Take a field out of a JSON file."""
    document = place = json.loads(path.read_text())
    for key in keys[:-1]:
        place = place[key]
    del place[keys[-1]]
    path.write_text(json.dumps(document))


@pytest.fixture
def robot(tmp_path, bare_bundle):
    """Bundle, plan, goal map and plant of today in one directory."""
    bundle = shutil.copytree(bare_bundle, tmp_path / "bundle")
    plan = small_plan(bundle)
    write_document(tmp_path / "plan.json", plan)
    read_plant().write(tmp_path / "plant.json")
    return tmp_path


@pytest.mark.parametrize(
    ("file", "keys", "command", "made_by"),
    [
        ("bundle/manifest.json", ["content_sha256"], "goalmap", "dropstitch train"),
        ("bundle/manifest.json", ["schema"], "goalmap", "dropstitch train"),
        ("plan.json", ["link"], "plan plan.json --improve run.mcap", "plan"),
        ("plan.json", ["schema"], "plan plan.json --improve run.mcap", "plan"),
        ("plant.json", ["schema"], "goalmap", "identify"),
    ],
)
def test_a_command_refuses_an_old_file(robot, capsys, monkeypatch, file, keys, command, made_by):
    monkeypatch.chdir(robot)
    without(robot / file, *keys)
    argv = [*command.split(), "--plant", "plant.json", "--bundle", "bundle", "--out", "out.json"]
    assert dropstitch(argv) == BAD_INPUT
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and file in said and made_by in said and keys[0] in said
