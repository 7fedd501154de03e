"""The commands from outside: results, exit codes and one sentence for each mistake."""

import csv
import dataclasses
import json
import shutil
import zipfile
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.core.signals import tip_names
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.manifest import write_manifest
from firmware_py.link.link_description import STUDY_LINK, LinkGravity
from firmware_py.link.marker_layout import square_corners_m
from fmu.fmpy_run import check_link_of_trial, inputs_from_trial
from fmu.fmu_models import FmuParts
from hil.emulator.physics import FmuPhysics
from models.plant.plant import read_plant
from models.shared.kinematics import base_corners_m
from models.trials.files import write_trial
from models.trials.trial import Trial, TrialMeta


@pytest.fixture(scope="module")
def twin(bundle_1dof, tmp_path_factory):
    path = tmp_path_factory.mktemp("twin") / "twin.fmu"
    assert main(["fmu", "build", str(bundle_1dof), "--out", str(path)]) == 0
    return path


def _rewritten(source, target, change):
    """Copy of an FMU with `change` applied to its files (name to bytes)."""
    with zipfile.ZipFile(source) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    with zipfile.ZipFile(target, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return target


def _read(path):
    with path.open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_simulate_writes_rows_and_a_drawing(twin, tmp_path, capsys):
    for payload in ("0", "2"):
        out = tmp_path / payload
        words = ["--out", str(out), "--payload-kg", payload, "--json"]
        assert main(["fmu", "simulate", str(twin), *words]) == 0
        assert json.loads(capsys.readouterr().out)["rows"] == 512
    columns = _read(out / "result.csv")
    assert columns["di"].mean() > _read(tmp_path / "0/result.csv")["di"].mean()
    assert columns["time_s"][-1] == pytest.approx(511 * 0.017)
    assert np.degrees(np.abs(columns["goal_1_rad"])).max() == pytest.approx(30.0, abs=0.01)
    assert set(columns["payload_kg"]) == {2.0}
    goal, angle = columns["goal_1_rad"], columns["angle_1_rad"]
    likeness = [np.corrcoef(goal[: 512 - lag], angle[lag:])[0, 1] for lag in range(60)]
    assert max(likeness) > 0.99  # the servo follows its goal within a second
    assert "<svg" in (out / "result.svg").read_text()[:500]


def _trial_of(columns, directory):
    """A trial whose servo and tip are a run's, with the markers of a straight link."""
    angle_rad = columns["angle_1_rad"][:, None]
    corners_m = square_corners_m(0.15)
    heights_m = [0.06 + 0.95 * row / 4 for row in (1, 2, 3, 4)]
    markers_m = np.concatenate([base_corners_m(angle_rad, h, corners_m) for h in heights_m], axis=1)
    named = [f"m{i:02d}_{axis}_m" for i in range(1, 17) for axis in "xyz"]
    copied = ("time_s", "goal_1_rad", "angle_1_rad", "current_1_a", *tip_names())
    trial = Trial(
        "run",
        TrialMeta(
            dof=1, payload_kg=1.0, pressure_pa=41.3e3, trial=1, motion="sinusoid", source="twin",
            period_s=4.352, amplitude_rad=0.5236, base_offset_m=0.06, link_length_m=0.95,
            link_width_m=0.15, rest_samples=1,
        ),
        {name: columns[name] for name in copied}
        | dict(zip(named, markers_m.reshape(len(angle_rad), 48).T, strict=True)),
    )  # fmt: skip
    return write_trial(trial, directory)


@pytest.mark.slow
def test_a_trial_gives_the_inputs_row_by_row(twin, bundle_1dof, tmp_path, capsys):
    """A trial recorded from the twin: the twin repeats it, the observer finds its tip."""
    assert main(["fmu", "simulate", str(twin), "--out", str(tmp_path), "--payload-kg", "1"]) == 0
    trial = str(_trial_of(_read(tmp_path / "result.csv"), tmp_path))
    observer = tmp_path / "observer.fmu"
    assert (
        main(["fmu", "build", str(bundle_1dof), "--unit", "observer", "--out", str(observer)]) == 0
    )
    capsys.readouterr()
    options = ["--out", str(tmp_path / "again"), "--trial", trial, "--json"]
    assert main(["fmu", "simulate", str(twin), *options]) == 0
    rms = json.loads(capsys.readouterr().out)["rms"]
    for name in ("angle_1_rad", "current_1_a", "tip_x_m", "tip_z_m"):
        assert rms[name] < 1e-9
    known = ["--set", "parameters.payload_known_kg=1"]
    assert main(["fmu", "simulate", str(observer), *options, *known]) == 0
    rms = json.loads(capsys.readouterr().out)["rms"]
    assert rms["payload_kg"] == 0.0
    assert rms["tip_x_m"] < 0.005


def test_a_trial_that_does_not_fit_is_refused(tmp_path, bundle_1dof, twin, capsys):
    assert main(["fmu", "simulate", str(twin), "--out", str(tmp_path)]) == 0
    path = _trial_of(_read(tmp_path / "result.csv"), tmp_path)
    toml = path.with_suffix(".toml")
    columns = path.read_text().replace("goal_1_rad,angle_1_rad,current_1_a", "x_rad,y_rad,z_a", 1)
    path.write_text(columns)
    assert main(["fmu", "simulate", str(twin), "--out", str(tmp_path), "--trial", str(path)]) == 2
    assert "column goal_1_rad is missing" in capsys.readouterr().err
    path.write_text(columns.replace("x_rad,y_rad,z_a", "goal_1_rad,angle_1_rad,current_1_a", 1))
    toml.write_text(toml.read_text().replace("link_length_m = 0.95", "link_length_m = 0.6"))
    assert main(["fmu", "simulate", str(twin), "--out", str(tmp_path), "--trial", str(path)]) == 2
    assert "link_length_m 0.6" in capsys.readouterr().err
    toml.unlink()
    assert main(["fmu", "simulate", str(twin), "--out", str(tmp_path), "--trial", str(path)]) == 2
    assert "run.toml: is missing" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--set parameters.link_mass_kg=1e6", "parameters.link_mass_kg = 1e+06 lies outside"),
        ("--set parameters.nonsense=1", "nonsense"),
        ("--set parameters.link_mass_kg=heavy", "'heavy'"),
        ("--payload-kg -0.3", "payload_kg = -0.3 lies outside 0 to 3"),
        ("--payload-kg 3.5", "payload_kg = 3.5 lies outside 0 to 3"),
    ],
)
def test_a_value_that_the_fmu_does_not_take_is_refused(twin, tmp_path, capsys, options, words):
    assert main(["fmu", "simulate", str(twin), "--out", str(tmp_path), *options.split()]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_a_payload_out_of_bounds_is_refused_behind_emulated_servos_too(twin):
    with pytest.raises(InputError, match=r"payload_kg = 3\.5 lies outside 0 to 3"):
        FmuPhysics(twin, dof=1, payload_kg=3.5)


def test_check_fails_an_fmu_whose_binary_lacks_a_function(twin, tmp_path, capsys):
    def hide(files):
        name = next(n for n in files if n.endswith(".so"))
        files[name] = files[name].replace(b"fmi3GetClock\0", b"fmi3GotClock\0")

    assert main(["fmu", "check", str(_rewritten(twin, tmp_path / "lacks.fmu", hide))]) == 1
    assert "lacks fmi3GetClock" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("missing.fmu", "is missing"),
        ("no_zip.fmu", "is not an FMU"),
        ("a_zip.fmu", "is not an FMU"),
    ],
)
def test_check_refuses_what_is_not_an_fmu(tmp_path, capsys, file, words):
    (tmp_path / "no_zip.fmu").write_bytes(b"no zip")
    with zipfile.ZipFile(tmp_path / "a_zip.fmu", "w") as archive:
        archive.writestr("readme.txt", "no description")
    assert main(["fmu", "check", str(tmp_path / file)]) == 2
    error = capsys.readouterr().err
    assert f"{file}: {words}" in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("build BUNDLE", "--out: is missing"),
        ("build BUNDLE --out any.zip", "does not end in .fmu"),
        ("build . --out any.fmu", "manifest.json: is missing"),
        ("ssp BUNDLE --payload-kg nan --out any.ssp", "--payload-kg: is nan kg"),
        ("build BUNDLE --plant no.toml --out any.fmu", "no.toml: is missing"),
        ("build BUNDLE --unit observer --fmi 2", "FMI 3.0"),
        ("build damaged --out any.fmu", "does not match the hash"),
    ],
)
def test_what_cannot_be_built_is_refused(
    bundle_1dof, tmp_path, monkeypatch, capsys, command, words
):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(bundle_1dof, "damaged")
    Path("damaged/predictor.onnx").write_bytes(b"damaged")
    assert main(["fmu", *command.replace("BUNDLE", str(bundle_1dof)).split()]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


# ---- Another link -------------------------------------------------------------------------------

META = TrialMeta(
    dof=1, payload_kg=1.0, trial=1, motion="sinusoid", source="twin", period_s=4.352,
    base_offset_m=0.06, link_length_m=0.95, link_width_m=0.15, rest_samples=1,
)  # fmt: skip


def parts(link=None):
    return FmuParts("twin", 1, dataclasses.replace(read_plant(), link=link), None)


@pytest.fixture
def bundle_of_plant(bundle_1dof, tmp_path):
    """Bundle that knows the plant that it was trained with."""
    directory = shutil.copytree(bundle_1dof, tmp_path / "bundle")
    manifest, sha256 = read_manifest(directory), read_plant().sha256()
    write_manifest(directory, msgspec.structs.replace(manifest, plant_sha256=sha256, files={}))
    return directory


@pytest.mark.parametrize(
    "words", [["build"], ["build", "--unit", "observer"], ["ssp"]], ids=["twin", "observer", "ssp"]
)
def test_a_plant_of_another_link_than_the_bundles_is_refused(
    bundle_of_plant, tmp_path, capsys, words
):
    short = tmp_path / "short.json"
    out = tmp_path / ("out.ssp" if words == ["ssp"] else "out.fmu")
    read_plant().with_values({"link_length_m": 0.6}).write(short)
    words = [*words, bundle_of_plant, "--plant", short, "--out", out]
    assert main(["fmu", *map(str, words)]) == 2
    error = capsys.readouterr().err
    assert str(short) in error and str(bundle_of_plant / "plant.json") in error
    assert "length_m 0.6" in error and "0.95" in error
    assert not out.exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"link_length_m": 0.6}, "link_length_m 0.6 instead of 0.95; .* parameters.link_length_m"),
        ({"link_width_m": 0.1}, "link_width_m 0.1 instead of 0.15"),
        ({"base_offset_m": 0.0}, "base_offset_m 0 instead of 0.06"),
        ({"gravity_m_s2": (-9.81, 0.0, 0.0)}, r"\[-9.81, 0, 0\] instead of \[0, 0, -9.81\]"),
    ],
)
def test_a_trial_of_another_link_than_the_fmus_is_refused(tmp_path, change, words):
    trial = SimpleNamespace(path=tmp_path, meta=msgspec.structs.replace(META, **change))
    with pytest.raises(InputError, match=words):
        check_link_of_trial(parts(), trial, {})


def test_a_trial_of_the_fmus_link_is_accepted():
    def trial(**change):
        return SimpleNamespace(path="", meta=msgspec.structs.replace(META, **change))

    horizontal = msgspec.structs.replace(STUDY_LINK, gravity=LinkGravity(mounting="horizontal"))
    check_link_of_trial(parts(), trial(), {})
    check_link_of_trial(parts()._replace(plant=None), trial(), {})
    check_link_of_trial(parts(), trial(link_length_m=0.93), {"parameters.link_length_m": 0.93})
    check_link_of_trial(parts(horizontal), trial(gravity_m_s2=(-9.81, 0.0, 0.0)), {})
    two = SimpleNamespace(path="run.csv", meta=SimpleNamespace(dof=2))
    with pytest.raises(InputError, match="of 2DOF, the FMU of 1DOF"):
        inputs_from_trial(SimpleNamespace(dof=1), None, two)
