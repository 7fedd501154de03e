"""The commands from outside: results, exit codes and one sentence for each mistake."""

import csv
import dataclasses
import json
import shutil
import zipfile
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.manifest import write_manifest
from firmware_py.link.link_description import STUDY_LINK, LinkGravity
from fmu.fmpy_run import check_link_of_trial, inputs_from_trial
from fmu.fmu_models import FmuParts
from hil.emulator.physics import FmuPhysics
from models.plant.plant import read_plant
from models.trials.files import write_trial
from tests.fmu.toy import rewritten


@pytest.fixture(scope="module")
def twin(bundle_1dof, tmp_path_factory):
    path = tmp_path_factory.mktemp("twin") / "twin.fmu"
    assert main(["fmu", "build", str(bundle_1dof), "--out", str(path)]) == 0
    return path


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


@pytest.fixture(scope="module")
def trial(toy_trials):
    """A trial of the study's link with 1 kg."""
    return toy_trials(1, amplitudes_deg=(30,), trials=(1,), payloads_kg=(1.0,))[0]


@pytest.mark.slow
def test_a_trial_gives_the_inputs_row_by_row(twin, trial, bundle_1dof, tmp_path, capsys):
    """A trial recorded from the twin: the twin repeats it, the observer estimates its tip."""
    assert main(["fmu", "simulate", str(twin), "--out", str(tmp_path), "--payload-kg", "1"]) == 0
    result = _read(tmp_path / "result.csv")
    columns = {name: column[: len(result["time_s"])] for name, column in trial.columns.items()}
    columns |= {name: column for name, column in result.items() if name in columns}
    trial = str(write_trial(dataclasses.replace(trial, columns=columns), tmp_path))
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


@pytest.mark.parametrize(
    ("suffix", "old", "new", "words"),
    [
        (".csv", "goal_1_rad", "x_rad", "column goal_1_rad is missing"),
        (".toml", "length_m = 0.95", "length_m = 0.9", "link_length_m 0.9 instead of 0.95; "),
        (".toml", "width_m = 0.15", "width_m = 0.1", "link_width_m 0.1 instead of 0.15"),
        (".toml", "offset_m = 0.06", "offset_m = 0.0", "base_offset_m 0 instead of 0.06"),
        (".toml", "dof = 1", "dof = 1\ngravity_m_s2 = [-9.81, 0, 0]", "instead of [0, 0, -9.81]"),
    ],
)
def test_a_trial_that_does_not_fit_the_fmu_is_refused(
    twin, trial, tmp_path, capsys, suffix, old, new, words
):
    path = write_trial(trial, tmp_path)
    file = path.with_suffix(suffix)
    content = file.read_text()
    assert old in content
    file.write_text(content.replace(old, new, 1))
    command = ["fmu", "simulate", str(twin), "--out", str(tmp_path), "--trial", str(path)]
    assert main(command) == 2
    assert words in capsys.readouterr().err
    if "length" in old:  # as the sentence says
        assert main([*command, "--set", "parameters.link_length_m=0.9"]) == 0


def test_a_trial_of_two_joints_is_refused_and_one_of_a_horizontal_link_fits_its_fmu(toy_trials):
    two = toy_trials(2, amplitudes_deg=(30,), trials=(1,), payloads_kg=(1.0,))[0]
    link = msgspec.structs.replace(STUDY_LINK, gravity=LinkGravity(mounting="horizontal"))
    parts = FmuParts("twin", 1, dataclasses.replace(read_plant(), link=link), None)
    with pytest.raises(InputError, match="of 2DOF, the FMU of 1DOF"):
        inputs_from_trial(parts, None, two)
    meta = msgspec.structs.replace(two.meta, gravity_m_s2=(-9.81, 0.0, 0.0))
    check_link_of_trial(parts, dataclasses.replace(two, meta=meta), {})


def test_a_payload_out_of_bounds_is_refused_behind_emulated_servos_too(twin):
    with pytest.raises(InputError, match=r"payload_kg = 3\.5 lies outside 0 to 3"):
        FmuPhysics(twin, dof=1, payload_kg=3.5)


def test_check_fails_an_fmu_whose_binary_lacks_a_function(twin, tmp_path, capsys):
    def hide(files):
        name = next(n for n in files if n.endswith(".so"))
        files[name] = files[name].replace(b"fmi3GetClock\0", b"fmi3GotClock\0")

    assert main(["fmu", "check", str(rewritten(twin, tmp_path / "lacks.fmu", hide))]) == 1
    assert "lacks fmi3GetClock" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda data: data[:30], "the file is cut short"),
        (lambda data: data[:9000], "the file is cut short"),  # mapped, its use ends the process
        (lambda _: 100 * b"no library ", "invalid ELF header"),
    ],
)
def test_a_damaged_library_is_named_by_check_and_simulate(twin, tmp_path, capsys, damage, words):
    def change(files):
        name = next(n for n in files if n.endswith(".so"))
        files[name] = damage(files[name])

    damaged = str(rewritten(twin, tmp_path / "cut.fmu", change))
    place = Path.cwd()
    assert main(["fmu", "check", damaged]) == 1
    out = capsys.readouterr().out
    assert "does not load" in out and words in out
    assert main(["fmu", "simulate", damaged, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "cut.fmu: cannot be instantiated" in error and words in error
    assert error.count("\n") == 1
    assert Path.cwd() == place


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("simulate TWIN --set parameters.link_mass_kg=1e6", "link_mass_kg = 1e+06 lies outside"),
        ("simulate TWIN --set parameters.nonsense=1", "nonsense"),
        ("simulate TWIN --set parameters.link_mass_kg=heavy", "'heavy'"),
        ("simulate TWIN --payload-kg -0.3", "payload_kg = -0.3 lies outside 0 to 3"),
        ("simulate TWIN --payload-kg 3.5", "payload_kg = 3.5 lies outside 0 to 3"),
        ("check missing.fmu", "missing.fmu: is missing"),
        ("check no_zip.fmu", "no_zip.fmu: is not an FMU"),
        ("check a_zip.fmu", "a_zip.fmu: is not an FMU"),
        ("build BUNDLE", "--out: is missing"),
        ("build BUNDLE --out any.zip", "does not end in .fmu"),
        ("build . --out any.fmu", "manifest.json: is missing"),
        ("ssp BUNDLE --payload-kg nan --out any.ssp", "--payload-kg: is nan kg"),
        ("build BUNDLE --plant no.toml --out any.fmu", "no.toml: is missing"),
        ("build BUNDLE --unit observer --fmi 2", "FMI 3.0"),
        ("build damaged --out any.fmu", "does not match the hash"),
    ],
)
def test_a_mistake_gets_one_sentence(
    twin, bundle_1dof, tmp_path, monkeypatch, capsys, command, words
):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(bundle_1dof, "damaged")
    Path("damaged/predictor.onnx").write_bytes(b"damaged")
    Path("no_zip.fmu").write_bytes(b"no zip")
    with zipfile.ZipFile("a_zip.fmu", "w") as archive:
        archive.writestr("readme.txt", "no description")
    line = command.replace("TWIN", f"{twin} --out out").replace("BUNDLE", str(bundle_1dof))
    assert main(["fmu", *line.split()]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


# ---- Another link -------------------------------------------------------------------------------


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
