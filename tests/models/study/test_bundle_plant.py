"""Plants for a bundle: an improved one is told, one of another link is refused by both commands."""

import dataclasses
import shutil

import msgspec
import pytest

from firmware_py.inference.manifest import read_bundle_files, write_manifest
from models.__main__ import main
from models.plant.plant import read_plant
from models.study.bundle_plant import plant_for_bundle, sha256_in_manifest
from tests.firmware_py.goals.outside.scripted_program import linear_map
from tests.firmware_py.goals.small_plan import STUDY


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


def test_the_plant_of_the_bundle_is_named_without_a_word(directory, tmp_path, capsys):
    named = plant_for_bundle(read_plant(), tmp_path, read_bundle_files(directory), "this map")
    found = named.in_document(linear_map())
    assert (found.plant_sha256, found.link) == (read_plant().sha256(), STUDY)
    assert capsys.readouterr().err == ""


def test_an_improved_plant_of_the_same_link_is_told_once(directory, tmp_path, capsys):
    better = read_plant().with_values({"link_mass_kg": 1.0})
    path = tmp_path / "better.json"
    named = plant_for_bundle(better, path, read_bundle_files(directory), "this plan")
    assert (named.sha256, named.link) == (better.sha256(), STUDY)
    said = capsys.readouterr().err
    assert said.startswith("warning: ") and str(path) in said and str(directory) in said
    assert said.count("\n") == 1


def test_a_manifest_of_an_earlier_version_has_the_hash_of_the_whole_plant(directory):
    plant = read_plant()
    floor = {"1": {"frequency_hz": "0", "repeats": 1, "noise": {}, "model": {}, "curves": {}}}
    provenance = msgspec.convert({"noise_floor": floor}, type(plant.provenance))
    whole = msgspec.structs.replace(plant.provenance, noise_floor=provenance.noise_floor)
    given = dataclasses.replace(plant, provenance=whole)
    manifest = read_bundle_files(directory).manifest
    assert sha256_in_manifest(given, manifest) == plant.sha256() != given.sha256()
    old = msgspec.structs.replace(manifest, plant_sha256=given.sha256())
    assert sha256_in_manifest(given, old) == given.sha256()


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
