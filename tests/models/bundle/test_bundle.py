"""Bundle on disk: directory, parity gate, contents, reproducibility."""

import json
import shutil

import msgspec
import onnx
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.manifest import read_bundle_files, write_manifest
from models.bundle.files import (
    GATE_M,
    ParityError,
    check_parity,
    replaced_bundle,
    write_bundle,
)
from models.bundle.plant import compare_with_bundle
from models.plant.plant import read_plant
from models.predictor.onnx_graphs import to_onnx
from models.study.document import read_study
from tests.models.predictor.cases import fitted_predictor

OLD = {"training_data_sha256": "", "plant_sha256": "", "files": {}}
NEW = {"plant.json": "new", "manifest.json": json.dumps(OLD | {"dof": 2})}
FOREIGN = dict.fromkeys(("my_notes.txt", "twin_1dof.fmu", "logs/run.mcap"), "foreign")


def write_files(directory, files):
    for name, text in files.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_text(text)


def files_of(directory):
    return {
        p.relative_to(directory).as_posix(): p.read_text()
        for p in directory.rglob("*") if p.is_file()
    }  # fmt: skip


def write_new(directory):
    with replaced_bundle(directory) as fresh:
        write_files(fresh, NEW)


@pytest.fixture
def old_bundle(tmp_path):
    """An old bundle, signed and with an observer, in which others have put files."""
    old = {name: "old" for name in ("plant.json", "observer.fmu", "manifest.sig")}
    write_files(tmp_path / "bundle", old | {"manifest.json": json.dumps(OLD)} | FOREIGN)
    return tmp_path / "bundle"


def test_the_files_of_an_old_bundle_are_replaced_and_no_others(old_bundle):
    write_new(old_bundle)
    assert files_of(old_bundle) == NEW | FOREIGN
    assert [p.name for p in old_bundle.parent.iterdir()] == ["bundle"], "scratch remains"


def test_a_failure_leaves_everything_as_it_was(old_bundle):
    before = files_of(old_bundle)
    with pytest.raises(KeyboardInterrupt), replaced_bundle(old_bundle) as fresh:
        write_files(fresh, NEW)
        raise KeyboardInterrupt
    assert files_of(old_bundle) == before
    assert [p.name for p in old_bundle.parent.iterdir()] == ["bundle"]


@pytest.mark.parametrize("manifest", ['{"name": "an extension of a browser"}', "no JSON"])
def test_a_directory_of_something_else_is_refused_and_unchanged(tmp_path, manifest, toy_fallback):
    write_files(tmp_path, {"manifest.json": manifest})
    with pytest.raises(InputError, match="is not a bundle"):
        write_bundle(tmp_path, read_plant(), toy_fallback)
    assert files_of(tmp_path) == {"manifest.json": manifest}


def test_gate_refuses_a_graph_that_is_off_by_a_nanometre(tmp_path):
    predictor, features = fitted_predictor(3, 3)
    graph, path = to_onnx(predictor.write_graph, 3), tmp_path / "predictor.onnx"
    onnx.save(graph, path)
    assert max(check_parity(path, predictor, features).values()) < GATE_M
    weights = next(i for i in graph.graph.initializer if i.name == "tip_m_constant")
    changed = onnx.numpy_helper.to_array(weights) * (1 + 1e-7)
    weights.CopyFrom(onnx.numpy_helper.from_array(changed, weights.name))
    onnx.save(graph, path)
    with pytest.raises(ParityError, match="no bundle written"):
        check_parity(path, predictor, features)


def test_bundle_holds_what_the_contract_lists_and_is_reproducible(
    toy_bundle, toy_fallback, toy_study, tmp_path
):
    manifest = read_manifest(toy_bundle)
    assert set(manifest.files) == {
        "predictor.onnx", "lagged.onnx", "plant.json", "study.json", "golden.npz", "MODEL_CARD.md",
    }  # fmt: skip
    assert [q.name for q in manifest.features] == ["angle_1_rad", "current_1_a", "di"]
    assert [(q.name, q.unit) for q in manifest.outputs] == [
        ("tip_x_m", "m"), ("tip_y_m", "m"), ("tip_z_m", "m"),
    ]  # fmt: skip
    plant = read_plant(toy_bundle / "plant.json")
    assert manifest.plant_sha256 == plant.sha256()
    assert not plant.provenance.noise_floor, "the robot needs none"
    study = read_study(toy_bundle / "study.json")
    assert study == toy_study
    assert manifest.degree == study.chosen_degree
    assert (toy_bundle / "study.json").stat().st_size < 600_000
    write_bundle(tmp_path / "again", read_plant(), toy_fallback, study=toy_study)
    for file in toy_bundle.iterdir():
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes(), file.name
    facts = onnx.load(toy_bundle / "predictor.onnx").metadata_props
    assert {"features", "outputs", "in_range", "half_width_m"} <= {prop.key for prop in facts}


def test_the_model_card_has_a_complete_row_for_everything(toy_bundle, toy_study):
    card = (toy_bundle / "MODEL_CARD.md").read_text(encoding="utf-8")
    tables = [block.splitlines() for block in card.split("\n\n") if block.startswith("|")]
    assert all(len({line.count(" | ") for line in table}) == 1 for table in tables)
    assert all(finding.text in card for finding in toy_study.findings)
    assert "None" not in card and "{" not in card


# --- plants for a bundle --------------------------------------------------------------------------


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
