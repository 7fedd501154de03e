"""System structure of an SSP package: twin, observer and controller (SSP 1.0, SystemStructure.ssd).

The controller sends goals to the twin, the twin sends measured angles and currents to the observer,
and the observer sends its estimated tip to the controller.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from typing import Final
from xml.etree import ElementTree as ET

from firmware_py.core.signals import PERIOD_S
from models.plant.step_model import StepModel, Variable, names

__all__ = ["PATHS", "system_structure"]

PATHS: Final = ("controller", "twin", "observer")
"""Components, in the order in which a host without a scheduling algorithm steps them."""

_FLOWS: Final = (("controller", "twin"), ("twin", "observer"), ("observer", "controller"))
"""Source and target of connections: outputs connect to inputs of the same name."""

STOP_TIME_S: Final = 20.0
SSD: Final = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC: Final = "http://ssp-standard.org/SSP1/SystemStructureCommon"
SSV: Final = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"


def system_structure(
    name: str, models: Mapping[str, StepModel], payload_kg: float, generated: str
) -> bytes:
    """Return SystemStructure.ssd."""
    for prefix, space in (("ssd", SSD), ("ssc", SSC), ("ssv", SSV)):
        ET.register_namespace(prefix, space)
    root = ET.Element(
        f"{{{SSD}}}SystemStructureDescription",
        {"name": name, "version": "1.0", "generationDateAndTime": generated},
    )
    system = ET.SubElement(root, f"{{{SSD}}}System", name=name)
    elements = ET.SubElement(system, f"{{{SSD}}}Elements")
    for path in PATHS:
        start = {"payload_kg": payload_kg} if path == "twin" else {}
        given = {n for source, to in _FLOWS if to == path for n in names(models[source].outputs)}
        _component(elements, path, models[path], given, start)
    connections = ET.SubElement(system, f"{{{SSD}}}Connections")
    for source, target in _FLOWS:
        wanted = names(models[target].inputs)
        for signal in (n for n in names(models[source].outputs) if n in wanted):
            ET.SubElement(
                connections, f"{{{SSD}}}Connection",
                startElement=source, startConnector=signal, endElement=target, endConnector=signal,
            )  # fmt: skip
    ET.SubElement(root, f"{{{SSD}}}DefaultExperiment", startTime="0.0", stopTime=repr(STOP_TIME_S))
    _libcosim_step(root[-1])
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _component(
    elements: ET.Element,
    path: str,
    model: StepModel,
    given: Container[str],
    start: Mapping[str, float],
) -> None:
    """Write a component with its connectors; an input without a source keeps its start value.

    Such an input has no connector, because FMPy 0.3.32 would feed it the signal of the previous
    connection.
    """
    component = ET.SubElement(
        elements, f"{{{SSD}}}Component",
        name=path, type="application/x-fmu-sharedlibrary", source=f"resources/{path}.fmu",
    )  # fmt: skip
    connectors = ET.SubElement(component, f"{{{SSD}}}Connectors")
    groups: Sequence[tuple[str, Sequence[Variable]]] = (
        ("input", [v for v in model.inputs if v.name in given]),
        ("output", [v for v in model.outputs if v.name != "in_range"]),
    )
    for kind, variables in groups:
        for variable in variables:
            connector = ET.SubElement(
                connectors, f"{{{SSD}}}Connector", name=variable.name, kind=kind
            )
            ET.SubElement(connector, f"{{{SSC}}}Real")
    if start:
        bindings = ET.SubElement(component, f"{{{SSD}}}ParameterBindings")
        binding = ET.SubElement(bindings, f"{{{SSD}}}ParameterBinding")
        values = ET.SubElement(binding, f"{{{SSD}}}ParameterValues")
        own = ET.SubElement(values, f"{{{SSV}}}ParameterSet", name=path, version="1.0")
        parameters = ET.SubElement(own, f"{{{SSV}}}Parameters")
        for parameter, value in start.items():
            entry = ET.SubElement(parameters, f"{{{SSV}}}Parameter", name=parameter)
            ET.SubElement(entry, f"{{{SSV}}}Real", value=repr(float(value)))


def _libcosim_step(experiment: ET.Element) -> None:
    """Write the communication step as an annotation of the Open Simulation Platform."""
    space = "http://opensimulationplatform.com/SSP/OSPAnnotations"
    ET.register_namespace("osp", space)
    annotations = ET.SubElement(experiment, f"{{{SSD}}}Annotations")
    annotation = ET.SubElement(
        annotations, f"{{{SSC}}}Annotation", type="com.opensimulationplatform"
    )
    algorithm = ET.SubElement(annotation, f"{{{space}}}Algorithm")
    ET.SubElement(algorithm, f"{{{space}}}FixedStepAlgorithm", baseStepSize=repr(PERIOD_S))
