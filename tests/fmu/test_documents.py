"""Documents of an FMU: reference run, page, icon, amplitudes of the example motion."""

import re
import struct
from pathlib import Path

import fmpy
import numpy as np
import pytest
from lxml import etree

from firmware_py.core.errors import InputError
from firmware_py.core.motion import STUDY_PERIOD_S, Motion
from firmware_py.core.signals import PERIOD_S
from firmware_py.link.link_description import LinkDescription, LinkServo
from fmu.documents import (
    FOLDER,
    documentation_page,
    fmu_documents,
    read_reference_run,
    reference_files,
    reference_run,
)
from fmu.fmpy_instance import FmuArchive
from fmu.fmu_builder import build_fmu
from fmu.fmu_checker import check_reference_run
from fmu.fmu_models import FmuParts
from fmu.interface import interface_of
from models.commands.new import link_toml
from models.plant.plant import read_plant
from models.plant.step_model import names

SCHEMAS = Path(fmpy.__file__).parent / "schema"


@pytest.fixture(scope="module")
def run(toy):
    time_s = PERIOD_S * np.arange(61)
    u = np.column_stack([2.0 * np.sin(3.0 * time_s), np.full(61, 0.5)])
    return reference_run(toy, u, PERIOD_S)


@pytest.fixture(scope="module")
def carrying(toy, run, tmp_path_factory):
    path = tmp_path_factory.mktemp("contents") / "pendulum.fmu"
    return build_fmu(toy, path, files=reference_files(run))


def test_a_replay_of_the_reference_run_notices_a_wrong_value(carrying, run):
    with FmuArchive(carrying) as archive:
        written = read_reference_run(archive.directory)
        np.testing.assert_array_equal(written.u, run.u)
        np.testing.assert_array_equal(written.y, run.y[::4])
        assert check_reference_run(archive, written).passed
        assert not check_reference_run(archive, written._replace(y=written.y + 1e-8)).passed
        other = written._replace(outputs=(*run.outputs[:-1], "no_such_name"))
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
        rows = np.asarray(result[name], dtype=float)
        np.testing.assert_allclose(rows, run.y[:, k], atol=1e-9, rtol=0)


@pytest.mark.parametrize(
    "damaged",
    [lambda text: text.replace("0.", "nan", 1), lambda text: "\n" + text,
     lambda text: text + "1" * 200_000, lambda text: text + "\n" * 1_000_000],
    ids=["nan", "no header", "long field", "large"],
)  # fmt: skip
def test_a_damaged_table_is_refused(carrying, damaged):
    with FmuArchive(carrying) as archive:
        table = archive.directory / FOLDER / "example_ref.csv"
        table.write_text(damaged(table.read_text()))
        with pytest.raises(InputError):
            read_reference_run(archive.directory)


def test_the_page_refers_to_nothing_outside_and_the_icon_fits_the_schema():
    parts = FmuParts("observer", 1, read_plant(), None)
    model = parts.model()
    documents = fmu_documents(parts, model, 3)
    page = documentation_page(interface_of(model, "none"), "<a counter>", documents.sections)
    assert page.count("<figure>") == 4 and "&lt;a counter&gt;" in page
    links = re.findall(r'(?:href|src)="([^"]*)"', page)
    assert all(link.startswith(("#", "data:")) for link in links)
    schema = etree.XMLSchema(etree.parse(str(SCHEMAS / "fmi3" / "fmi3TerminalsAndIcons.xsd")))
    schema.assertValid(etree.fromstring(documents.files["terminalsAndIcons/terminalsAndIcons.xml"]))
    icon = documents.files["terminalsAndIcons/icon.png"]
    assert struct.unpack(">II", icon[16:24]) == (128, 128)


def test_the_example_of_a_twin_is_the_studys_motion_and_holds_the_payload():
    parts = FmuParts("twin", 1, read_plant(), None)
    model = parts.model()
    example = dict(zip(names(model.inputs), fmu_documents(parts, model, 3).example, strict=True))
    goal_rad = Motion().table_rad(PERIOD_S)
    quarter = round(STUDY_PERIOD_S / PERIOD_S / 4)
    assert example["payload_kg"] == 0.0
    assert example["goal_1_rad"] == pytest.approx(goal_rad[quarter, 0], abs=1e-12)


def test_the_reference_run_has_a_payload_that_the_link_carries(tmp_path):
    """With 1 kg the arm would fall: the current of this servo is at its limit."""
    servo = LinkServo(model="XM430-W350")
    link = LinkDescription(length_m=0.6, width_m=0.1, payload_kg=0.1, joints=1, servo=servo)
    (tmp_path / "link.toml").write_text(link_toml(link, 0.4, 0.1), encoding="utf-8")
    parts = FmuParts("observer", 1, read_plant(tmp_path / "link.toml"), None)
    files = fmu_documents(parts, parts.model(), 2).files
    assert "model.png" in files
    table = files[f"{FOLDER}/example_in.csv"].decode().splitlines()
    _, angle_rad, current_a = np.loadtxt(table, delimiter=",", skiprows=1).T
    assert np.abs(angle_rad).max() < 0.6
    assert np.abs(current_a).max() < link.preset.current_limit_a
