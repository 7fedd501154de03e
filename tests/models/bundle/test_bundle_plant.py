"""Plants for a bundle: an improved one is told, one of another link is refused by both commands."""

import shutil

import msgspec
import pytest

from dropstitch.__main__ import main
from firmware_py.inference.manifest import read_bundle_files, write_manifest
from models.bundle.plant import compare_with_bundle
from models.plant.plant import read_plant


@pytest.fixture
def directory(bare_bundle, tmp_path):
    """Bundle with the nominal plant."""
    directory = tmp_path / "bundle"
    shutil.copytree(bare_bundle, directory)
    plant = read_plant()
    plant.write(directory / "plant.json")
    manifest = read_bundle_files(bare_bundle).manifest
    write_manifest(directory, msgspec.structs.replace(manifest, plant_sha256=plant.sha256()))
    return directory


def test_the_plant_of_the_bundle_is_taken_without_a_word(directory, tmp_path, capsys):
    compare_with_bundle(read_plant(), tmp_path, read_bundle_files(directory), "this map")
    assert capsys.readouterr().err == ""


def test_an_improved_plant_of_the_same_link_is_told_once(directory, tmp_path, capsys):
    better = read_plant().with_values({"link_mass_kg": 1.0})
    path = tmp_path / "better.json"
    compare_with_bundle(better, path, read_bundle_files(directory), "this plan")
    said = capsys.readouterr().err
    assert said.startswith("warning: ") and str(path) in said and str(directory) in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("words", [["goalmap"], ["plan", "line"]])
def test_a_plant_of_another_link_is_refused(directory, tmp_path, capsys, words):
    short, out = tmp_path / "short.json", tmp_path / "out.json"
    read_plant().with_values({"link_length_m": 0.6}).write(short)
    words = [*words, "--plant", short, "--bundle", directory, "--out", out]
    assert main([str(word) for word in words]) == 2
    said = capsys.readouterr().err
    assert str(short) in said and str(directory / "plant.json") in said
    assert "length_m 0.6" in said and "0.95" in said
    assert not out.exists()
