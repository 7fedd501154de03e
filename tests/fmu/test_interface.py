"""Interface of an FMU: variables, dependencies, and the model description that FMPy reads."""

from dataclasses import replace

import fmpy
import pytest

from firmware_py.core.units import VALUE_UNITS
from fmu.interface import interface_of, model_description_xml


def test_dependencies_of_the_start_are_those_of_the_equations(toy):
    """Those in motion are compared with derivatives in test_derivatives.py."""
    interface = interface_of(toy)
    by_name = {v.name: v.reference for v in interface.variables}

    def known(output):
        table = interface.initial_dependencies
        return {interface.variables[r].name for r in table[by_name[output]]}

    # as tests/fmu/toy.py has it
    assert known("tip_x_m") == {"payload_kg", "parameters.length_m", "parameters.rest_rad"}
    assert known("torque_filtered_nm") == {"torque_nm"}


def test_a_model_whose_inputs_are_measured_at_the_end_is_sampled(toy):
    interface = interface_of(replace(toy, inputs_at_end=True))
    assert interface.relations.sampled
    assert interface.derivatives == interface.indicators == ()
    assert {v.variability for v in interface.of("output")} == {"discrete"}


def test_variables_are_described_by_causality_unit_start_and_bounds(toy_fmu, toy):
    """As FMPy reads them back."""
    description = fmpy.read_model_description(str(toy_fmu))
    read = {v.name: v for v in description.modelVariables}
    assert [v.valueReference for v in read.values()] == list(range(len(read)))
    assert {"der(states.angle_rad)", "indicators.limit_1", "indicators.limit_2"} < set(read)
    for group, causality, prefix in (
        (toy.inputs, "input", ""), (toy.parameters, "parameter", "parameters."),
        (toy.outputs, "output", ""),
    ):  # fmt: skip
        for v in group:
            found = read[prefix + v.name]
            assert found.causality == causality
            if v.name != "in_range":
                shown = VALUE_UNITS.get(v.unit)
                assert (found.unit, found.displayUnit) == (v.unit, shown.name if shown else None)
            if causality != "output":
                assert float(found.start) == v.start
                assert (float(found.min), float(found.max)) == (v.minimum, v.maximum)
    assert read["in_range"].type == "Boolean"
    assert read["der(states.rate_rad_s)"].unit == "rad/s2"
    # outputs that follow from discrete states alone change at events only
    variability = {"tip_x_m": "continuous", "steps": "discrete", "in_range": "discrete",
                   "states.count": "discrete", "states.angle_rad": "continuous"}  # fmt: skip
    assert {name: read[name].variability for name in variability} == variability


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
