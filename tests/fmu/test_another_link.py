"""Parts of two links are not mixed, and a run without a payload takes one of the FMU's link."""

import dataclasses
import json
import shutil
from types import SimpleNamespace

import msgspec
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.manifest import write_manifest
from firmware_py.link.link_description import STUDY_LINK, LinkDescription, LinkGravity
from fmu.fmu_models import FmuParts
from fmu.stimulus import check_link_of_trial, usual_payload_kg
from models.plant.plant import read_plant
from models.trials.trial import TrialMeta

SMALL = LinkDescription(length_m=0.6, width_m=0.1, payload_kg=0.1)
META = TrialMeta(
    dof=1, payload_kg=1.0, trial=1, motion="sinusoid", source="twin", period_s=4.352,
    base_offset_m=0.06, link_length_m=0.95, link_width_m=0.15, rest_samples=1,
)  # fmt: skip


def parts(link=None):
    return FmuParts("twin", 1, dataclasses.replace(read_plant(), link=link), None)


@pytest.fixture
def bundle(bundle_1dof, tmp_path):
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
def test_a_plant_of_another_link_than_the_bundles_is_refused(bundle, tmp_path, capsys, words):
    short = tmp_path / "short.json"
    out = tmp_path / ("out.ssp" if words == ["ssp"] else "out.fmu")
    read_plant().with_values({"link_length_m": 0.6}).write(short)
    words = [*words, bundle, "--plant", short, "--out", out]
    assert main(["fmu", *map(str, words)]) == 2
    said = capsys.readouterr().err
    assert str(short) in said and str(bundle / "plant.json") in said
    assert "length_m 0.6" in said and "0.95" in said
    assert not out.exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"link_length_m": 0.6}, "link_length_m 0.6 in place of 0.95; give .* parameters.link_l"),
        ({"link_width_m": 0.1}, "link_width_m 0.1 in place of 0.15"),
        ({"base_offset_m": 0.0}, "base_offset_m 0 in place of 0.06"),
        ({"gravity_m_s2": (-9.81, 0.0, 0.0)}, r"\[-9.81, 0, 0\] in place of \[0, 0, -9.81\]"),
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


def test_the_usual_payload_goes_by_the_link():
    assert usual_payload_kg(parts()) == usual_payload_kg(parts(STUDY_LINK)) == 1.0
    assert usual_payload_kg(parts(SMALL)) == 0.05


@pytest.mark.parametrize(("given", "held_kg"), [([], 0.05), (["--payload-kg", "0.1"], 0.1)])
def test_a_package_holds_a_payload_of_its_link(
    bundle_1dof, tmp_path, capsys, monkeypatch, given, held_kg
):
    built = []

    def build(twin, observer, output, *, payload_kg, platforms):
        built.append(payload_kg)
        output.touch()

    monkeypatch.setattr("fmu.ssp.ssp_builder.build_ssp", build)
    plant, out = tmp_path / "plant.json", tmp_path / "link.ssp"
    parts(SMALL).plant.write(plant)
    words = ["ssp", bundle_1dof, "--plant", plant, "--out", out, "--json", *given]
    assert main(["fmu", *map(str, words)]) == 0
    assert built == [json.loads(capsys.readouterr().out)["payload_kg"]] == [held_kg]
