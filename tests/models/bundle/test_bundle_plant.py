"""Plants for a bundle: a changed one is warned of, one of another link is refused."""

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


def test_another_plant_of_the_same_link_is_warned_of_once(directory, tmp_path, capsys):
    files, path = read_bundle_files(directory), tmp_path / "better.json"
    compare_with_bundle(read_plant(), path, files, "this map")
    assert capsys.readouterr().err == ""
    compare_with_bundle(read_plant().with_values({"link_mass_kg": 1.0}), path, files, "this plan")
    warning = capsys.readouterr().err
    assert warning.startswith("warning: ") and str(path) in warning and str(directory) in warning
    assert warning.count("\n") == 1


@pytest.mark.parametrize("words", [["goalmap"], ["plan", "line"]])
def test_a_plant_of_another_link_is_refused(directory, tmp_path, capsys, words):
    short, out = tmp_path / "short.json", tmp_path / "out.json"
    read_plant().with_values({"link_length_m": 0.6}).write(short)
    words = [*words, "--plant", short, "--bundle", directory, "--out", out]
    assert main([str(word) for word in words]) == 2
    refusal = capsys.readouterr().err
    assert str(short) in refusal and str(directory / "plant.json") in refusal
    assert "length_m 0.6" in refusal and "0.95" in refusal
    assert not out.exists()
