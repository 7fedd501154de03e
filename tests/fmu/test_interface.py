"""Interface of an FMU: variables, dependencies, and the model description that FMPy reads."""

import zipfile
from dataclasses import replace

import fmpy
import pytest

from firmware_py.core.units import VALUE_UNITS
from fmu.interface import interface_of, model_description_xml
from models.plant.step_model import names
from tests.fmu.conftest import TORQUE_NM


def test_value_references_number_time_inputs_parameters_outputs(toy):
    interface = interface_of(toy)
    assert [v.reference for v in interface.variables] == list(range(len(interface.variables)))
    assert [v.name for v in interface.variables] == [
        "time",
        *names(toy.inputs),
        *(f"parameters.{name}" for name in names(toy.parameters)),
        *names(toy.outputs),
        *(f"states.{name}" for name in names(toy.states)),
        "der(states.angle_rad)",
        "der(states.rate_rad_s)",
        "indicators.limit_1",
        "indicators.limit_2",
    ]


def test_dependencies_are_those_of_the_equations(toy):
    interface = interface_of(toy)
    by_name = {v.name: v.reference for v in interface.variables}

    def known(table, output):
        return {interface.variables[r].name for r in table[by_name[output]]}

    # read off tests/fmu/toy.py: the tip follows the angle and the length, the mass its input
    assert known(interface.dependencies, "tip_x_m") == {
        "parameters.length_m", "states.angle_rad",
    }  # fmt: skip
    assert known(interface.dependencies, "mass_kg") == {"payload_kg"}
    assert known(interface.dependencies, "steps") == set()
    assert known(interface.dependencies, "der(states.angle_rad)") == {"states.rate_rad_s"}
    assert known(interface.dependencies, "der(states.rate_rad_s)") == {
        "torque_nm", "payload_kg", "parameters.length_m", "parameters.damping_nms_rad",
        "states.angle_rad", "states.rate_rad_s",
    }  # fmt: skip
    assert known(interface.dependencies, "indicators.limit_1") == {"torque_nm"}
    assert known(interface.initial_dependencies, "tip_x_m") == {
        "payload_kg", "parameters.length_m", "parameters.rest_rad",
    }  # fmt: skip
    assert known(interface.initial_dependencies, "torque_filtered_nm") == {"torque_nm"}


def test_states_are_continuous_where_they_have_a_rate(toy):
    interface = interface_of(toy)
    variables = {v.name: v for v in interface.variables}
    assert [v.name for v in interface.continuous_states] == [
        "states.angle_rad", "states.rate_rad_s",
    ]  # fmt: skip
    assert variables["states.count"].variability == "discrete"
    # outputs that follow from discrete states alone change at events only
    assert variables["steps"].variability == "discrete"
    assert variables["tip_x_m"].variability == "continuous"
    assert (variables["in_range"].type, variables["in_range"].variability) == (
        "Boolean", "discrete",
    )  # fmt: skip
    assert variables["der(states.rate_rad_s)"].unit == "rad/s2"


def test_a_model_whose_inputs_are_measured_at_the_end_is_sampled(toy):
    interface = interface_of(replace(toy, inputs_at_end=True))
    assert interface.relations.sampled
    assert interface.derivatives == interface.indicators == ()
    assert {v.variability for v in interface.of("output")} == {"discrete"}


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


def test_the_zip_holds_documents(toy_fmu):
    with zipfile.ZipFile(toy_fmu) as archive:
        assert "A pendulum &amp; &lt;a counter&gt;." in (
            archive.read("documentation/index.html").decode()
        )
        assert b"Apache License" in archive.read("documentation/licenses/license.txt")


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
