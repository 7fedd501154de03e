"""Build directories whose files have names of their own."""

import shutil

import pytest

from hil.report.build_files import find_files
from hil.report.build_inputs import read_build
from models.plant.plant import NOMINAL, read_plant


@pytest.fixture
def renamed(build, tmp_path):
    """The build directory with every file and directory called otherwise."""
    names = {
        "bundle_1dof": "arm", "bundle_2dof": "two joints", "study_2dof_phase0": "a",
        "study_2dof_phase90": "b", "sil_1dof": "first run",
        "evaluate_unseen_20deg.json": "compared.json", "check_twin_1dof.json": "twin.json",
    }  # fmt: skip
    for old, new in names.items():
        path = build / old
        copy = shutil.copytree if path.is_dir() else shutil.copyfile
        copy(path, tmp_path / new)
    return tmp_path


def test_files_are_found_by_what_they_hold(build, renamed):
    usual, found = read_build(build), read_build(renamed)
    assert found.studies == usual.studies
    assert found.motions == usual.motions
    assert found.manifests == usual.manifests
    assert list(found.evaluations.values()) == list(usual.evaluations.values())
    assert found.checks == {"twin": usual.checks["twin_1dof"]}
    assert [loop.name for loop in found.loops] == ["first run"]
    assert found.left_out == []


def test_a_study_written_with_a_bundle_around_it_stays_a_study(build, tmp_path):
    """`models train --study-only` writes a manifest too, which is no robot's."""
    for name in ("bundle_1dof", "bundle_2dof", "study_2dof_phase0", "study_2dof_phase90"):
        shutil.copytree(build / name, tmp_path / name)
    for phase in (0, 90):
        (tmp_path / f"study_2dof_phase{phase}" / "manifest.json").write_text("{}")
    usual, found = read_build(build), read_build(tmp_path)
    assert found.motions == usual.motions
    assert found.manifests == usual.manifests
    assert found.left_out == []


def test_what_has_no_place_is_listed(renamed):
    shutil.copytree(renamed / "arm", renamed / "bundle_1dof")
    shutil.copytree(renamed / "a", renamed / "c")
    found = read_build(renamed)
    assert [left.split(":")[0] for left in found.left_out] == ["arm", "c"]


def test_one_run_alone_is_a_build(renamed):
    (loop,) = read_build(renamed / "first run").loops
    assert loop.dof == 1


def test_a_plant_is_found_under_any_name_and_the_usual_one_comes_first(tmp_path):
    (tmp_path / "notes.json").write_text("[1, 2]")
    (tmp_path / "broken.json").write_text("{")
    plant = read_plant(NOMINAL)
    plant.write(tmp_path / "arm.json")
    assert find_files(tmp_path).plant == tmp_path / "arm.json"
    plant.write(tmp_path / "plant.json")
    files = find_files(tmp_path)
    assert files.plant == tmp_path / "plant.json"
    assert [left.split(":")[0] for left in files.left_out] == ["arm.json"]
