"""Documents of an FMU: reference run, terminals, icon, sections of its documentation."""

import re
import struct
import xml.etree.ElementTree as ET
from pathlib import Path

import fmpy
import numpy as np
import pytest
from lxml import etree

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from fmu.fmpy_instance import FmuArchive
from fmu.fmu_builder import build_fmu
from fmu.fmu_models import FmuParts
from fmu.interface import interface_of
from fmu.packaging.plant_pages import plant_sections
from fmu.packaging.reference_run import (
    FOLDER,
    read_reference_run,
    reference_files,
    reference_run,
)
from fmu.packaging.terminals import terminal_files
from fmu.parity import check_reference_run
from models.plant import plant as plant_module
from models.plant.plant import read_plant
from models.plant.step_model import names

EXAMPLES = Path(plant_module.__file__).parent / "examples"
SCHEMAS = Path(fmpy.__file__).parent / "schema"


@pytest.fixture(scope="module")
def run(toy):
    time_s = PERIOD_S * np.arange(61)
    u = np.column_stack([2.0 * np.sin(3.0 * time_s), np.full(61, 0.5)])
    return reference_run(toy, u, PERIOD_S)


@pytest.fixture(scope="module")
def carrying(toy, run, tmp_path_factory):
    path = tmp_path_factory.mktemp("contents") / "pendulum.fmu"
    files = reference_files(run, {"documentation/index.html": "document"})
    return build_fmu(toy, path, files=files | terminal_files(interface_of(toy), 3))


def test_the_reference_run_reads_back_as_it_was(carrying, run):
    with FmuArchive(carrying) as archive:
        found = read_reference_run(archive.directory)
    for value, expected in zip(found, run, strict=True):
        np.testing.assert_array_equal(value, expected)


def test_a_replay_notices_a_wrong_value(carrying, run):
    wrong = run._replace(y=run.y + 1e-8)
    other = run._replace(outputs=(*run.outputs[:-1], "no_such_name"))
    with FmuArchive(carrying) as archive:
        assert check_reference_run(archive, run).passed
        assert not check_reference_run(archive, wrong).passed
        assert not check_reference_run(archive, other).passed


def test_fmpy_takes_the_inputs_as_its_input_file(carrying, run, toy):
    """`fmpy simulate --input-file` gives the reference results."""
    with FmuArchive(carrying) as archive:
        table = archive.directory / FOLDER / "example_in.csv"
        result = fmpy.simulate_fmu(
            str(carrying), fmi_type="CoSimulation", input=fmpy.read_csv(str(table)),
            stop_time=60 * PERIOD_S, step_size=PERIOD_S, output_interval=PERIOD_S,
            output=names(toy.outputs),
        )  # fmt: skip
    for k, name in enumerate(run.outputs):
        rows = np.asarray(result[name], dtype=float)[::4]
        np.testing.assert_allclose(rows, run.y[:, k], atol=1e-9, rtol=0)


@pytest.mark.parametrize(
    "damaged",
    [lambda text: text.replace("0.", "nan", 1), lambda text: "\n" + text, lambda _: "",
     lambda text: text + "1" * 200_000, lambda text: text + "\n" * 1_000_000],
    ids=["nan", "no header", "empty", "long field", "large"],
)  # fmt: skip
def test_a_damaged_table_is_refused(carrying, damaged):
    with FmuArchive(carrying) as archive:
        table = archive.directory / FOLDER / "example_ref.csv"
        table.write_text(damaged(table.read_text()))
        with pytest.raises(InputError):
            read_reference_run(archive.directory)


def test_the_manifest_lists_files_that_are_there(carrying):
    with FmuArchive(carrying) as archive:
        folder = archive.directory / FOLDER
        related = ET.parse(folder / "fmi-ls-manifest.xml").getroot().findall("Related")
        assert {r.get("role") for r in related} == {"testcase", "result", "document"}
        assert all((folder / r.get("source")).is_file() for r in related)


@pytest.mark.parametrize("kind", ["twin", "observer"])
def test_terminals_and_icon_are_valid(kind):
    interface = interface_of(read_plant().step_model(1, kind))
    files = terminal_files(interface, 3)
    schema = etree.XMLSchema(etree.parse(str(SCHEMAS / "fmi3" / "fmi3TerminalsAndIcons.xsd")))
    root = etree.fromstring(files["terminalsAndIcons/terminalsAndIcons.xml"])
    schema.assertValid(root)
    terminal = next(t for t in root.iter("Terminal") if t.get("name") == "measurement")
    members = [m.get("memberName") for m in terminal]
    assert members == ["angle_1_rad", "current_1_a"]  # the same on both sides
    for name in ("terminalsAndIcons/icon.png",):
        assert struct.unpack(">II", files[name][16:24]) == (128, 128)
    assert list(terminal_files(interface, 2)) == ["model.png"]


def test_the_documentation_tells_every_equation_and_parameter():
    plant = read_plant()
    parts = FmuParts("observer", 1, plant, None)
    sections = {s.id: s for s in plant_sections(parts, interface_of(parts.model()))}
    equations = sections["equations"].parts[0].text
    assert all(f"Effect: {name}" in equations for name in plant.effects)
    assert "τ_root" in equations
    rows = sections["parameters"].parts[0].rows
    assert [row[0] for row in rows] == list(plant.parameters)
    assert {"inputs", "validation"} <= set(sections)


@pytest.mark.parametrize(
    ("plant", "follows"),
    [(None, {"di": "payload_kg"}), ("xl330_pendulum", {"current_1_a": "goal_1_rad"})],
    ids=["link on a cascade", "pendulum on a duty cycle"],
)
def test_the_documentation_tells_which_outputs_follow_a_changed_input(plant, follows):
    """What the page says is what the model does before the next step."""
    read = read_plant(EXAMPLES / f"{plant}.toml") if plant else read_plant()
    model = read.step_model(1, "twin")
    sections = plant_sections(FmuParts("twin", 1, read, None), interface_of(model))
    told = next(s for s in sections if s.id == "inputs").parts[-1].text
    outputs, inputs = names(model.outputs), names(model.inputs)
    u = np.array([v.start for v in model.inputs]) + 0.01
    x, p = model.initial(u, model.parameter_values()), model.parameter_values()
    before = np.asarray(model.output(x, u, p)).ravel()
    for k, name in enumerate(inputs):
        after = np.asarray(model.output(x, u + 0.2 * (np.arange(len(u)) == k), p)).ravel()
        for output in np.array(outputs)[after != before]:
            assert re.search(rf"\b{output} \([^)]*\b{name}\b[^)]*\)", told)
    for output, name in follows.items():
        assert re.search(rf"\b{output} \([^)]*\b{name}\b", told)
    assert ("current" in told) == ("current_1_a" in follows)
