"""Observer FMU: in a bundle, on angles that no motion leads to, at rest."""

import shutil
import zipfile

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.inference.golden import read_golden
from firmware_py.inference.manifest import write_manifest
from fmu.fmu_builder import build_fmu
from fmu.fmu_models import read_parts
from fmu.packaging import HOST, SOURCE_CODE
from models.plant.plant import read_plant
from models.plant.step_model import names

OUTPUTS = ["di", "tip_x_m", "tip_y_m", "tip_z_m", "payload_kg"]


# ---- In a bundle --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def completed(bundle, tmp_path_factory):
    """A bundle with its observer, built by the command."""
    directory = tmp_path_factory.mktemp("completed") / "bundle"
    shutil.copytree(bundle, directory)
    asked = ["--platforms", f"{HOST},{SOURCE_CODE}"]
    assert main(["fmu", "build", str(directory), "--unit", "observer", *asked]) == 0
    return directory


def test_the_robot_accepts_the_completed_bundle(completed):
    loaded = ModelBundle.load(completed)
    assert loaded.manifest.estimator == "observer"
    assert {"observer.fmu", "golden.npz", "plant.json"} <= set(loaded.manifest.files)
    assert loaded.manifest.plant_sha256 == read_plant(completed / "plant.json").sha256()
    files = zipfile.ZipFile(completed / "observer.fmu").namelist()
    for folder in ("sources/", f"binaries/{HOST}/"):
        assert any(name.startswith(folder) for name in files)


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


@pytest.mark.slow
def test_a_swapped_observer_is_refused_by_its_golden_ticks(completed, tmp_path):
    """An FMU of another plant with its correct hash in the manifest: the replay detects it."""
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


# ---- Restarts -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def observer_1dof(tmp_path_factory):
    model = read_plant().step_model(1, "observer")
    return build_fmu(model, tmp_path_factory.mktemp("observer") / "observer_1dof.fmu")


@pytest.fixture(scope="module", params=[1, 2], ids=["1dof", "2dof"])
def observer(request, observer_1dof):
    """The FMU, with its number of joints and its interpreted model."""
    model, path = read_plant().step_model(request.param, "observer"), observer_1dof
    if request.param == 2:
        path = build_fmu(model, path.with_name("observer_2dof.fmu"))
    with FmuInstance(path) as fmu:
        yield fmu, request.param, model


def _take(fmu, dof, angle_rad, current_a=0.0, step_s=PERIOD_S):
    joints = range(1, dof + 1)
    sample = [f"angle_{j}_rad" for j in joints] + [f"current_{j}_a" for j in joints]
    fmu.set(sample, [angle_rad] * dof + [current_a] * dof)
    fmu.step(step_s)
    return fmu.get(OUTPUTS)


@pytest.mark.parametrize("angle_rad", [0.5, -5.0, 1e308])
def test_a_cold_start_far_from_zero_is_the_warm_start_there(observer, angle_rad):
    """The inputs are not set before initialization: the first sample comes with the first step."""
    fmu, dof, _ = observer
    fmu.reset()
    fmu.start()
    cold = np.array([_take(fmu, dof, angle_rad) for _ in range(50)])
    fmu.reset()
    fmu.set([f"angle_{j}_rad" for j in range(1, dof + 1)], [angle_rad] * dof)
    fmu.start()
    warm = np.array([_take(fmu, dof, angle_rad) for _ in range(50)])
    np.testing.assert_allclose(cold, warm, atol=1e-9, rtol=0)
    assert np.ptp(cold[:, -1]) == 0.0  # at rest nothing is learnt of the payload


def test_a_jump_keeps_the_payload_and_rests_at_the_sample(observer):
    fmu, dof, _ = observer
    fmu.reset()
    for k in range(120):
        current_a = 3.0 * np.sign(np.cos(0.05 * k))
        before = _take(fmu, dof, 0.3 * np.sin(0.05 * k), current_a)
    assert before[-1] != 1.0  # the prior: something was learnt
    after = [_take(fmu, dof, -0.5) for _ in range(3)]
    assert {row[-1] for row in after} == {before[-1]}
    np.testing.assert_allclose(after[2], after[0], atol=1e-3, rtol=0)


@pytest.mark.parametrize("step_s", [1e-3, PERIOD_S, 0.5])
def test_samples_at_random_are_never_refused(observer, step_s):
    """Jumps below and above what counts as one; the outputs are always finite numbers."""
    fmu, dof, _ = observer
    fmu.reset()
    random = np.random.default_rng(3)
    for k in range(150):
        size = (0.08, 1.0, 10.0)[k % 3] if k > 75 else 0.08
        row = _take(fmu, dof, size * random.choice([-1, 1]), random.normal() * 100, step_s)
        assert np.isfinite(row).all()
    for _ in range(20):
        row = _take(fmu, dof, 0.1)
    assert np.isfinite(row).all()


def test_the_fmu_restarts_like_the_interpreted_model(observer):
    fmu, dof, model = observer
    steps = np.array([0.0, 0.1, 4.0, 4.0, 4.1, 0.0, 0.05])
    u = np.column_stack([steps] * dof + [np.full(len(steps), 0.5)] * dof)
    rows = [names(model.outputs).index(name) for name in OUTPUTS]
    expected = model.simulate(u, PERIOD_S)[1:, rows]
    fmu.reset()
    found = [_take(fmu, dof, angle_rad, 0.5) for angle_rad in steps]
    np.testing.assert_allclose(found, expected, atol=1e-9, rtol=0)


def test_a_state_that_no_link_can_have_begins_anew(observer):
    _, _, model = observer
    u, p = np.full(len(model.inputs), 0.4), model.parameter_values()
    start = np.asarray(model.initial(u, p)).ravel()
    bend = names(model.states).index("root_bend_1_rad")
    for value in (4.0, -4.0, np.nan, np.inf, 1e200):
        damaged = start.copy()
        damaged[bend] = value
        after = np.asarray(model.finish(damaged, u, p, PERIOD_S)).ravel()
        np.testing.assert_array_equal(after, start)
