"""Observer FMU in a bundle: golden ticks, refusals, failed builds."""

import shutil
import zipfile

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.core.signals import feature_names
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.golden import read_golden
from fmu.fmu_builder import build_fmu
from fmu.fmu_models import read_parts
from fmu.packaging.platforms import HOST, SOURCE_CODE
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names


@pytest.fixture(scope="module")
def completed(bundle, tmp_path_factory):
    """A bundle with its observer, built by the command."""
    directory = tmp_path_factory.mktemp("completed") / "bundle"
    shutil.copytree(bundle, directory)
    asked = ["--platforms", f"{HOST},{SOURCE_CODE}"]
    assert main(["fmu", "build", str(directory), "--unit", "observer", *asked]) == 0
    return directory


def test_the_bundle_holds_every_platform_that_was_asked_for(completed):
    names_in = zipfile.ZipFile(completed / "observer.fmu").namelist()
    assert any(name.startswith("sources/") for name in names_in)
    assert any(name.startswith(f"binaries/{HOST}/") for name in names_in)


def test_the_robot_accepts_the_completed_bundle(completed):
    loaded = ModelBundle.load(completed)
    assert loaded.manifest.estimator == "observer"
    assert {"observer.fmu", "golden.npz", "plant.json"} <= set(loaded.manifest.files)
    assert loaded.manifest.plant_sha256 == read_plant(completed / "plant.json").sha256()


def test_golden_ticks_are_the_plants(completed, bundle):
    """The motion is the bundle's own; the answers are those of the run that the study makes."""
    manifest = read_manifest(completed)
    golden = read_golden(completed / "golden.npz", manifest.dof)
    before = read_golden(bundle / "golden.npz", manifest.dof)
    np.testing.assert_array_equal(golden.angle_rad, before.angle_rad)
    np.testing.assert_array_equal(golden.current_a, before.current_a)
    model = read_plant(completed / "plant.json").step_model(manifest.dof, "observer")
    columns = dict(
        zip(feature_names(manifest.dof), [*golden.angle_rad.T, *golden.current_a.T], strict=False)
    )
    u = np.column_stack([columns[name] for name in names(model.inputs)])
    y = CompiledModel(model).simulate(u, golden.step_s)[1:]
    answers = dict(zip(names(model.outputs), y.T, strict=True))
    np.testing.assert_allclose(golden.di, answers["di"], atol=1e-9, rtol=0)
    np.testing.assert_allclose(golden.payload_kg, answers["payload_kg"], atol=1e-9, rtol=0)
    assert np.ptp(golden.di) > 1e-4


def test_a_sample_that_is_no_number_is_answered_with_nan_and_not_taken(completed):
    loaded = ModelBundle.load(completed)
    golden = read_golden(completed / "golden.npz", loaded.manifest.dof)
    samples = list(zip(golden.angle_rad, golden.current_a, strict=True))
    estimator = loaded.estimator

    def follow():
        return [estimator.update(*sample, golden.step_s).di for sample in samples[10:20]]

    for angle_rad, current_a in samples[:10]:
        estimator.update(angle_rad, current_a, golden.step_s)
    assert np.isnan(estimator.update(samples[10][0], np.nan * current_a, golden.step_s).di)
    np.testing.assert_allclose(follow(), golden.di[10:20], rtol=1e-12)


def test_a_swapped_observer_is_refused_by_its_golden_ticks(completed, tmp_path):
    """An FMU of another plant with its correct hash in the manifest: the replay detects it."""
    from firmware_py.inference.manifest import write_manifest

    directory = tmp_path / "bundle"
    shutil.copytree(completed, directory)
    manifest = read_manifest(directory)
    plant = read_plant(directory / "plant.json")
    plant.with_values({"link_mass_kg": 1.3 * plant.parameters["link_mass_kg"].value}).write(
        tmp_path / "heavier.json"
    )
    parts = read_parts("observer", manifest.dof, directory, tmp_path / "heavier.json")
    build_fmu(parts.model(), directory / "observer.fmu")
    write_manifest(directory, manifest)
    with pytest.raises(InputError, match="tick"):
        ModelBundle.load(directory)


def test_a_failed_build_leaves_the_bundle_as_it_was(bundle_1dof, tmp_path, capsys):
    directory = tmp_path / "bundle"
    shutil.copytree(bundle_1dof, directory)
    (directory / "golden.npz").write_bytes(b"damaged")
    before = (directory / "manifest.json").read_bytes()
    assert main(["fmu", "build", str(directory), "--unit", "observer"]) == 2
    assert not (directory / "observer.fmu").exists()
    assert (directory / "manifest.json").read_bytes() == before
    assert "golden.npz" in capsys.readouterr().err
