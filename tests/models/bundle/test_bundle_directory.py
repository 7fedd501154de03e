"""Directory of a bundle: what is replaced there, and what is kept."""

import json

import pytest

from firmware_py.errors import InputError
from models.bundle.files import check_bundle_directory, replaced_bundle

OLD = {"training_data_sha256": "", "plant_sha256": "", "files": {}}
FOREIGN = ("my_notes.txt", "twin_1dof.fmu", "logs/run.mcap")


def write_files(directory, **contents):
    directory.mkdir(parents=True, exist_ok=True)
    for name, text in contents.items():
        (directory / name.replace("__", ".")).write_text(text)


def files_of(directory):
    return {
        p.relative_to(directory).as_posix(): p.read_text()
        for p in directory.rglob("*") if p.is_file()
    }  # fmt: skip


def write_new(directory):
    with replaced_bundle(directory) as fresh:
        write_files(fresh, plant__json="new", manifest__json=json.dumps(OLD | {"dof": 2}))


NEW = {"plant.json": "new", "manifest.json": json.dumps(OLD | {"dof": 2})}


@pytest.fixture
def old_bundle(tmp_path):
    """An old bundle, signed and with an observer, in which others have put files."""
    directory = tmp_path / "bundle"
    write_files(
        directory, plant__json="old", observer__fmu="old", manifest__sig="old",
        manifest__json=json.dumps(OLD),
    )  # fmt: skip
    for name in FOREIGN:
        (directory / name).parent.mkdir(exist_ok=True)
        (directory / name).write_text("kept")
    return directory


def test_the_files_of_an_old_bundle_are_replaced_and_others_kept(old_bundle):
    write_new(old_bundle)
    assert files_of(old_bundle) == NEW | dict.fromkeys(FOREIGN, "kept")
    assert [p.name for p in old_bundle.parent.iterdir()] == ["bundle"], "no scratch is left"


def test_a_failure_leaves_everything_as_it_was(old_bundle):
    before = files_of(old_bundle)
    with pytest.raises(KeyboardInterrupt), replaced_bundle(old_bundle) as fresh:
        write_files(fresh, plant__json="new")
        raise KeyboardInterrupt
    assert files_of(old_bundle) == before
    assert [p.name for p in old_bundle.parent.iterdir()] == ["bundle"]


def test_two_writers_at_once_do_not_meet(tmp_path):
    out = tmp_path / "new" / "bundle"
    with replaced_bundle(out) as first:
        write_files(first, plant__json="first")
        write_new(out)
        write_files(first, manifest__json="first")
    assert files_of(out) == {"plant.json": "first", "manifest.json": "first"}
    assert [p.name for p in out.parent.iterdir()] == ["bundle"]


def test_the_working_directory_may_be_the_bundle(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    write_new(tmp_path.joinpath("here").relative_to(tmp_path / "here"))
    assert files_of(tmp_path / "here") == NEW


def test_a_new_bundle_may_be_read_by_those_who_may_read_its_neighbours(tmp_path):
    (tmp_path / "usual").mkdir()
    write_new(tmp_path / "bundle")
    assert (tmp_path / "bundle").stat().st_mode == (tmp_path / "usual").stat().st_mode


@pytest.mark.parametrize("manifest", ['{"name": "an extension of a browser"}', "[]", "no JSON"])
def test_a_manifest_of_something_else_makes_no_bundle(tmp_path, manifest):
    write_files(tmp_path, manifest__json=manifest)
    with pytest.raises(InputError, match="is not a bundle"):
        check_bundle_directory(tmp_path)
    with pytest.raises(InputError, match="is not a bundle"):
        write_new(tmp_path)
    assert files_of(tmp_path) == {"manifest.json": manifest}


def test_nothing_is_made_by_the_check(tmp_path):
    for place in (tmp_path, tmp_path / "new" / "bundle"):
        check_bundle_directory(place)
    assert not list(tmp_path.iterdir())
