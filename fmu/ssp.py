"""SSP package: FMUs of controller, twin and observer, and their system structure (SSP 1.0).

The controller sends goals to the twin, the twin sends measured angles and currents to the observer,
and the observer sends its estimated tip to the controller.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final
from xml.etree import ElementTree as ET

import casadi as ca

from firmware_py.core.motion import STUDY_PERIOD_S
from firmware_py.core.signals import PERIOD_S, tip_names
from fmu.fmu_builder import build_fmu
from fmu.fmu_models import FmuParts
from fmu.packaging import build_time_s, date_and_time, write_zip
from models.plant.step_model import StepModel, Variable, names

PATHS: Final = ("controller", "twin", "observer")
"""Components, in the order in which a host without a scheduling algorithm steps them."""

_FLOWS: Final = (("controller", "twin"), ("twin", "observer"), ("observer", "controller"))
"""Source and target of connections: outputs connect to inputs of the same name."""

STOP_TIME_S: Final = 20.0


def build_ssp(
    twin: FmuParts,
    observer: FmuParts,
    output: Path,
    *,
    payload_kg: float,
    platforms: Sequence[str],
    report: Callable[[str], None] = lambda text: None,
) -> Path:
    """Build the package; the observer has to estimate `payload_kg`, the payload of the twin."""
    controller = tip_controller(twin.dof)
    models = dict(zip(PATHS, (controller, twin.model(), observer.model()), strict=True))
    descriptions = {
        "controller": "Controller that leads the tip of the link along a sinusoid.",
        "twin": twin.description(),
        "observer": observer.description(),
    }
    epoch_s = build_time_s()
    name = f"link_{twin.dof}dof"
    structure = system_structure(name, models, payload_kg, date_and_time(epoch_s))
    content = {"SystemStructure.ssd": structure}
    with TemporaryDirectory(prefix="dropstitch-ssp-") as scratch:
        for path, model in models.items():
            report(f"building the {path}")
            built = build_fmu(
                model, Path(scratch) / f"{path}.fmu", fmi=2, description=descriptions[path],
                platforms=platforms,
            )  # fmt: skip
            content[f"resources/{path}.fmu"] = built.read_bytes()
    write_zip(content, output, epoch_s)
    return output


# ---- System structure ---------------------------------------------------------------------------

SSD: Final = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC: Final = "http://ssp-standard.org/SSP1/SystemStructureCommon"
SSV: Final = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"


def system_structure(
    name: str, models: Mapping[str, StepModel], payload_kg: float, generated: str
) -> bytes:
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
        fed = {n for source, to in _FLOWS if to == path for n in names(models[source].outputs)}
        _component(elements, path, models[path], fed, start)
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
    fed: Container[str],
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
        ("input", [v for v in model.inputs if v.name in fed]),
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
        group = ET.SubElement(values, f"{{{SSV}}}ParameterSet", name=path, version="1.0")
        parameters = ET.SubElement(group, f"{{{SSV}}}Parameters")
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


# ---- Controller ---------------------------------------------------------------------------------

AMPLITUDE_RAD: Final = 0.4
"""Amplitude of the reference: within the study's 30 degrees with the bend of 2 kg [assumed]."""
GAIN_1_S: Final = 0.5
"""Gain of the integral: a time constant of 2 s, slower than the link's vibration of 1 Hz
[assumed]."""
BOUND_RAD: Final = 0.3
"""Bound of the integral: the bend of the link with 2 kg is below 0.2 rad [assumed]."""


def tip_controller(dof: int) -> StepModel:
    """Compose the controller: it moves the tip along a sinusoid, with the estimated tip.

    Inputs are tip_x_m, tip_y_m and tip_z_m, outputs goal_j_rad. The direction φ of the tip from the
    base includes the angle of the joint and the bend of the link. The goal is the reference plus
    the integral of the error, which removes the mean of the bend::

        φ_1 = atan2(x, z),   φ_2 = asin(y / |r|),   İ_j = k (r_j(t) − φ_j),   goal_j = r_j + I_j
    """
    joints = range(1, dof + 1)
    x, u, p = ca.SX.sym("x", 1 + dof), ca.SX.sym("u", 3), ca.SX.sym("p", 3)
    h = ca.SX.sym("h")
    amplitude, period_s, gain = ca.vertsplit(p)
    size = ca.sqrt(ca.sumsqr(u) + 1e-12)
    direction = ca.vertcat(ca.atan2(u[0], u[2] + 1e-12), ca.asin(u[1] / size))[:dof]
    reference = -amplitude * ca.sin(2 * ca.pi * x[0] / period_s) * ca.SX.ones(dof)
    integral = x[1:] + h * gain * (reference - direction)
    bounded = ca.fmin(ca.fmax(integral, -BOUND_RAD), BOUND_RAD)
    stay = ca.Function("stay", [x, u, p, h], [x])
    outputs = [
        Variable(f"goal_{j}_rad", "rad", 0.0, f"goal of joint {j}", nominal=0.5) for j in joints
    ]
    return StepModel(
        name=f"controller_{dof}dof",
        inputs=tuple(Variable(name, "m", 0.0, "estimated end effector") for name in tip_names()),
        parameters=(
            Variable("amplitude_rad", "rad", AMPLITUDE_RAD, "of the reference", 0.0, 0.6, 0.5),
            Variable("period_s", "s", STUDY_PERIOD_S, "of the reference", 1.0, 600.0, 4.0),
            Variable("gain_1_s", "1/s", GAIN_1_S, "of the integral", 0.0, 5.0),
        ),
        states=(
            Variable("phase_s", "s"),
            *(Variable(f"integral_{j}_rad", "rad", nominal=0.1) for j in joints),
        ),
        outputs=tuple(outputs),
        initial=ca.Function("initial", [u, p], [ca.SX.zeros(1 + dof)]),
        begin=ca.Function("begin", [x, u, p, h], [ca.vertcat(x[0], bounded)]),
        flow=stay,
        finish=ca.Function("finish", [x, u, p, h], [ca.vertcat(x[0] + h, x[1:])]),
        output=ca.Function("output", [x, u, p], [reference + x[1:]]),
        max_substep_s=1.0,
    )
