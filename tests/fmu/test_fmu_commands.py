"""The commands from outside: results, exit codes and one sentence for each mistake."""

import csv
import dataclasses
import json
import shutil
import zipfile
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.core.signals import tip_names
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.manifest import write_manifest
from firmware_py.link.link_description import STUDY_LINK, LinkDescription, LinkGravity
from firmware_py.link.marker_layout import square_corners_m
from fmu.fmpy_run import check_link_of_trial, inputs_from_trial
from fmu.fmu_models import FmuParts
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
    kept = ("time_s", "goal_1_rad", "angle_1_rad", "current_1_a", *tip_names())
    trial = Trial(
        "run",
        TrialMeta(
            dof=1, payload_kg=1.0, pressure_pa=41.3e3, trial=1, motion="sinusoid", source="twin",
            period_s=4.352, amplitude_rad=0.5236, base_offset_m=0.06, link_length_m=0.95,
            link_width_m=0.15, rest_samples=1,
        ),
        {name: columns[name] for name in kept}
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


def test_a_trial_of_two_joints_is_no_input_of_one(tmp_path):
    trial = SimpleNamespace(path=tmp_path / "run.csv", meta=SimpleNamespace(dof=2))
    with pytest.raises(InputError, match="of 2DOF, the FMU of 1DOF; give a trial of 1DOF"):
        inputs_from_trial(SimpleNamespace(dof=1), None, trial)


def test_a_parameter_is_set_before_the_start(twin, tmp_path, capsys):
    options = ["fmu", "simulate", str(twin), "--out", str(tmp_path), "--set"]
    assert main([*options, "parameters.link_mass_kg=1e6"]) == 2
    assert "parameters.link_mass_kg = 1e+06 lies outside" in capsys.readouterr().err
    assert main([*options, "parameters.nonsense=1"]) == 2
    assert main([*options, "parameters.link_mass_kg=heavy"]) == 2
    assert "'heavy' is not a number" in capsys.readouterr().err


def test_check_fails_an_fmu_whose_binary_lacks_a_function(twin, tmp_path, capsys):
    def hide(files):
        name = next(n for n in files if n.endswith(".so"))
        files[name] = files[name].replace(b"fmi3GetClock\0", b"fmi3GotClock\0")

    assert main(["fmu", "check", str(_rewritten(twin, tmp_path / "lacks.fmu", hide))]) == 1
    assert "lacks fmi3GetClock" in capsys.readouterr().out


@pytest.mark.slow
def test_check_fails_a_description_without_units(twin, tmp_path, capsys):
    def strip(files):
        xml = files["modelDescription.xml"].decode()
        before, after = xml.split('name="current_1_a"')
        after = after.replace(' unit="A"', "", 1)
        files["modelDescription.xml"] = f'{before}name="current_1_a"{after}'.encode()

    assert main(["fmu", "check", str(_rewritten(twin, tmp_path / "bare.fmu", strip))]) == 1
    assert "missing on current_1_a" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(None, "is missing"), (b"no zip", "is not an FMU"), ("no description", "is not an FMU")],
)
def test_check_refuses_what_is_not_an_fmu(tmp_path, capsys, content, sentence):
    path = tmp_path / "any.fmu"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("readme.txt", content)
    assert main(["fmu", "check", str(path)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert "Traceback" not in error


def test_build_refuses_with_one_sentence(bundle_1dof, tmp_path, capsys):
    bundle, out = str(bundle_1dof), str(tmp_path / "any.fmu")
    cases = {
        "--out: is missing": ["build", bundle],
        "does not end in .fmu": ["build", bundle, "--out", str(tmp_path / "any.zip")],
        "manifest.json: is missing": ["build", str(tmp_path), "--out", out],
        "--payload-kg: is nan kg": ["ssp", bundle, "--payload-kg", "nan", "--out", f"{out}.ssp"],
        "toml: is missing": ["build", bundle, "--plant", str(tmp_path / "no.toml"), "--out", out],
        "cannot run on the robot (FMI 3.0)": ["build", bundle, "--unit", "observer", "--fmi", "2"],
    }
    for sentence, arguments in cases.items():
        assert main(["fmu", *arguments]) == 2
        error = capsys.readouterr().err
        assert sentence in error
        assert error.count("\n") == 1


def test_build_refuses_a_damaged_predictor(bundle_1dof, tmp_path, capsys):
    directory = tmp_path / "bundle"
    shutil.copytree(bundle_1dof, directory)
    (directory / "predictor.onnx").write_bytes(b"damaged")
    assert main(["fmu", "build", str(directory), "--out", str(tmp_path / "any.fmu")]) == 2
    assert "does not match the hash" in capsys.readouterr().err


# ---- Another link -------------------------------------------------------------------------------

SMALL = LinkDescription(length_m=0.6, width_m=0.1, payload_kg=0.1)
META = TrialMeta(
    dof=1, payload_kg=1.0, trial=1, motion="sinusoid", source="twin", period_s=4.352,
    base_offset_m=0.06, link_length_m=0.95, link_width_m=0.15, rest_samples=1,
)  # fmt: skip


def parts(link=None):
    return FmuParts("twin", 1, dataclasses.replace(read_plant(), link=link), None)


@pytest.fixture
def bundle_of_plant(bundle_1dof, tmp_path):
    """Bundle that knows the plant that it was trained with."""
    directory = tmp_path / "bundle"
    shutil.copytree(bundle_1dof, directory)
    known = msgspec.structs.replace(
        read_manifest(directory), plant_sha256=read_plant().sha256(), files={}
    )
    write_manifest(directory, known)
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
    said = capsys.readouterr().err
    assert str(short) in said and str(bundle_of_plant / "plant.json") in said
    assert "length_m 0.6" in said and "0.95" in said
    assert not out.exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"link_length_m": 0.6}, "link_length_m 0.6 instead of 0.95; give .* parameters.link_l"),
        ({"link_width_m": 0.1}, "link_width_m 0.1 instead of 0.15"),
        ({"base_offset_m": 0.0}, "base_offset_m 0 instead of 0.06"),
        ({"gravity_m_s2": (-9.81, 0.0, 0.0)}, r"\[-9.81, 0, 0\] instead of \[0, 0, -9.81\]"),
    ],
)
def test_a_trial_of_another_link_than_the_fmus_is_refused(tmp_path, change, words):
    trial = SimpleNamespace(path=tmp_path, meta=msgspec.structs.replace(META, **change))
    with pytest.raises(InputError, match=words):
        check_link_of_trial(parts(), trial, {})


def test_a_trial_of_the_fmus_link_passes_also_with_its_size_set_before_the_start():
    trial = SimpleNamespace(path="trial.csv", meta=META)
    check_link_of_trial(parts(), trial, {})
    check_link_of_trial(parts()._replace(plant=None), trial, {})
    shorter = SimpleNamespace(path="", meta=msgspec.structs.replace(META, link_length_m=0.93))
    check_link_of_trial(parts(), shorter, {"parameters.link_length_m": 0.93})
    lying = SimpleNamespace(
        path="", meta=msgspec.structs.replace(META, gravity_m_s2=(-9.81, 0.0, 0.0))
    )
    mounted = msgspec.structs.replace(STUDY_LINK, gravity=LinkGravity(mounting="horizontal"))
    check_link_of_trial(parts(mounted), lying, {})


@pytest.mark.parametrize(("given", "held_kg"), [([], 0.05), (["--payload-kg", "0.1"], 0.1)])
def test_a_package_holds_a_payload_of_its_link(
    bundle_1dof, tmp_path, capsys, monkeypatch, given, held_kg
):
    built = []

    def build(twin, observer, output, *, payload_kg, platforms, report):
        built.append(payload_kg)
        output.touch()

    monkeypatch.setattr("fmu.ssp.build_ssp", build)
    plant, out = tmp_path / "plant.json", tmp_path / "link.ssp"
    parts(SMALL).plant.write(plant)
    words = ["ssp", bundle_1dof, "--plant", plant, "--out", out, "--json", *given]
    assert main(["fmu", *map(str, words)]) == 0
    assert built == [json.loads(capsys.readouterr().out)["payload_kg"]] == [held_kg]
