"""Model description (modelDescription.xml) of an FMU."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal
from xml.etree import ElementTree as ET

from firmware_py import __version__
from firmware_py.core.signals import PERIOD_S
from firmware_py.core.units import VALUE_UNITS
from fmu.interface import FmiVariable, Interface, finite_bounds
from fmu.packaging.source_code import add_source_files
from models.trials.units import base_exponents

FmiVersion = Literal[2, 3]

STOP_TIME_S = 2 * 256 * PERIOD_S
"""Default stop time: two cycles of the study's motion (paper, section IV-A)."""


def model_description_xml(
    interface: Interface,
    fmi: FmiVersion,
    token: str,
    description: str,
    generated: str,
    sources: Sequence[str] = (),
) -> bytes:
    """Return modelDescription.xml for FMI 2.0 or 3.0.

    FMI 2.0 lists the C files under sources/ here, by their names `sources`.
    """
    root = _root(interface, fmi, token, description, generated)
    if fmi == 2:
        root.set("numberOfEventIndicators", str(interface.relations.indicators))
    root.append(_model_exchange(interface, fmi))
    root.append(_co_simulation(interface, fmi))
    root.append(_unit_definitions(interface))
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="refused calls")
    ET.SubElement(
        root, "DefaultExperiment",
        startTime="0.0", stopTime=repr(STOP_TIME_S), stepSize=repr(PERIOD_S),
    )  # fmt: skip
    variables = ET.SubElement(root, "ModelVariables")
    for variable in interface.variables:
        variables.append(_variable_2(variable) if fmi == 2 else _variable_3(variable))
    root.append(_structure_2(interface) if fmi == 2 else _structure_3(interface))
    if fmi == 2 and sources:
        add_source_files(root, sources)
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _root(
    interface: Interface, fmi: FmiVersion, token: str, description: str, generated: str
) -> ET.Element:
    return ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{fmi}.0",
            "modelName": interface.name,
            {2: "guid", 3: "instantiationToken"}[fmi]: token,
            "description": description,
            "version": __version__,
            "license": "Apache-2.0",
            "generationTool": f"dropstitch {__version__}",
            "generationDateAndTime": generated,
            "variableNamingConvention": "structured",
        },
    )


def _model_exchange(interface: Interface, fmi: FmiVersion) -> ET.Element:
    element = ET.Element("ModelExchange", _capabilities(interface, fmi))
    needed = {2: ("completedIntegratorStepNotNeeded", "true"), 3: ("needsCompletedIntegratorStep",
              "false")}  # fmt: skip
    element.set(*needed[fmi])
    return element


def _co_simulation(interface: Interface, fmi: FmiVersion) -> ET.Element:
    element = ET.Element("CoSimulation", _capabilities(interface, fmi))
    element.set("canHandleVariableCommunicationStepSize", "true")
    return element


def _capabilities(interface: Interface, fmi: FmiVersion) -> dict[str, str]:
    """Attributes that both interface types share."""
    spelling = "FMUstate" if fmi == 2 else "FMUState"
    offered = interface.relations.derivatives
    capabilities = {
        "modelIdentifier": interface.name,
        f"canGetAndSet{spelling}": "true",
        f"canSerialize{spelling}": "true",
    }
    if fmi == 2:
        capabilities["canNotUseMemoryManagementFunctions"] = "true"
    if offered != "none":
        capabilities[f"providesDirectionalDerivative{'s' if fmi == 3 else ''}"] = "true"
    if offered == "both" and fmi == 3:
        capabilities["providesAdjointDerivatives"] = "true"
    return capabilities


def _unit_definitions(interface: Interface) -> ET.Element:
    definitions = ET.Element("UnitDefinitions")
    for name in interface.units:
        unit = ET.SubElement(definitions, "Unit", name=name)
        exponents = {symbol: str(power) for symbol, power in base_exponents(name).items()}
        ET.SubElement(unit, "BaseUnit", exponents)
        if name in VALUE_UNITS:
            shown = VALUE_UNITS[name]
            ET.SubElement(unit, "DisplayUnit", name=shown.name, factor=repr(shown.factor))
    return definitions


def _common(variable: FmiVariable) -> dict[str, str]:
    attributes = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.initial:
        attributes["initial"] = variable.initial
    if variable.description:
        attributes["description"] = variable.description
    return attributes


def _values(variable: FmiVariable) -> dict[str, str]:
    """Attributes of the value: unit, bounds, nominal, start."""
    attributes = {}
    if variable.type == "Float64":
        attributes["unit"] = variable.unit
        if variable.unit in VALUE_UNITS:
            attributes["displayUnit"] = VALUE_UNITS[variable.unit].name
        attributes.update({name: repr(value) for name, value in finite_bounds(variable).items()})
        if variable.causality != "independent" and variable.derivative_of is None:
            attributes["nominal"] = repr(variable.nominal)
    if variable.causality in ("input", "parameter"):
        attributes["start"] = repr(float(variable.start))
    return attributes


def _variable_2(variable: FmiVariable) -> ET.Element:
    element = ET.Element("ScalarVariable", _common(variable))
    kind = {"Float64": "Real", "Boolean": "Boolean"}[variable.type]
    value = ET.SubElement(element, kind, _values(variable))
    if variable.derivative_of is not None:
        value.set("derivative", str(variable.derivative_of + 1))
    return element


def _variable_3(variable: FmiVariable) -> ET.Element:
    tag: str = variable.type
    element = ET.Element(tag, {**_common(variable), **_values(variable)})
    if variable.derivative_of is not None:
        element.set("derivative", str(variable.derivative_of))
    return element


def _structure_2(interface: Interface) -> ET.Element:
    """Structure in FMI 2.0, where indices begin at 1 and parameters are knowns only initially."""
    structure = ET.Element("ModelStructure")
    parameters = {v.reference for v in interface.of("parameter")}
    groups = {
        "Outputs": [v.reference for v in interface.of("output")],
        "Derivatives": [v.reference for v in interface.derivatives],
        "InitialUnknowns": list(interface.initial_dependencies),
    }
    for tag, unknowns in groups.items():
        if not unknowns:
            continue
        group = ET.SubElement(structure, tag)
        initial = tag == "InitialUnknowns"
        of = interface.initial_dependencies if initial else interface.dependencies
        for unknown in unknowns:
            knowns = [k + 1 for k in of[unknown] if initial or k not in parameters]
            ET.SubElement(
                group, "Unknown", index=str(unknown + 1), dependencies=_list(sorted(knowns))
            )
    return structure


def _structure_3(interface: Interface) -> ET.Element:
    structure = ET.Element("ModelStructure")
    now, initial = interface.dependencies, interface.initial_dependencies
    groups = (
        ("Output", [v.reference for v in interface.of("output")], now),
        ("ContinuousStateDerivative", [v.reference for v in interface.derivatives], now),
        ("InitialUnknown", list(initial), initial),
        ("EventIndicator", [v.reference for v in interface.indicators], now),
    )
    for tag, unknowns, of in groups:
        for unknown in unknowns:
            ET.SubElement(
                structure, tag, valueReference=str(unknown), dependencies=_list(list(of[unknown]))
            )
    return structure


def _list(numbers: list[int]) -> str:
    return " ".join(map(str, numbers))
