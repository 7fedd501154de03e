import re
import zipfile

import fmpy
import pytest
from fmpy.validation import validate_fmu

from firmware_py.core.units import VALUE_UNITS
from fmu.interface import interface_of
from fmu.model_description import model_description_xml
from tests.fmu.conftest import TORQUE_NM


def test_fmpy_finds_no_problem(toy_fmu):
    assert validate_fmu(str(toy_fmu)) == []


def test_variables_are_those_of_the_table(toy_fmu, toy):
    """What FMPy reads back is what the interface table says, value by value."""
    description = fmpy.read_model_description(str(toy_fmu))
    read = {v.name: v for v in description.modelVariables}
    table = interface_of(toy, example=(TORQUE_NM, 0.0)).variables
    assert list(read) == [v.name for v in table]
    for v in table:
        found = read[v.name]
        assert (found.valueReference, found.causality, found.variability) == (
            v.reference, v.causality, v.variability,
        )  # fmt: skip
        assert found.type == (
            v.type if description.fmiVersion[0] == "3" or v.type == "Boolean" else "Real"
        )
        if v.type == "Float64":
            assert found.unit == v.unit
            shown = VALUE_UNITS.get(v.unit)
            assert found.displayUnit == (shown.name if shown else None)
        if v.causality in ("input", "parameter"):
            assert float(found.start) == v.start
            assert (float(found.min), float(found.max)) == (v.minimum, v.maximum)


def test_dates_are_valid_and_the_zip_holds_documents(toy_fmu):
    with zipfile.ZipFile(toy_fmu) as archive:
        xml = archive.read("modelDescription.xml").decode()
        page = archive.read("documentation/index.html").decode()
        licence = archive.read("documentation/licenses/license.txt").decode()
    date = re.search(r'generationDateAndTime="([^"]+)"', xml).group(1)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", date)
    assert "A pendulum &amp; &lt;a counter&gt;." in page
    assert "Apache License" in licence


@pytest.mark.parametrize("fmi", [2, 3])
def test_dependencies_are_counted_as_the_version_counts(toy, fmi):
    """FMI 2.0 counts from 1 and leaves parameters out of the outputs' knowns."""
    xml = model_description_xml(interface_of(toy), fmi, "{t}", "", "2026-01-01T00:00:00Z").decode()
    tip = next(v.reference for v in interface_of(toy).variables if v.name == "tip_x_m")
    angle = next(v.reference for v in interface_of(toy).variables if v.name == "states.angle_rad")
    length = next(v.reference for v in interface_of(toy).variables if "length" in v.name)
    expected = {
        2: f'<Unknown index="{tip + 1}" dependencies="{angle + 1}" />',
        3: f'<Output valueReference="{tip}" dependencies="{length} {angle}" />',
    }
    assert expected[fmi] in xml
