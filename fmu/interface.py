"""External interface of an FMU: its variables, as C tables and as modelDescription.xml.

Value references number the variables in this order: time, inputs, parameters, outputs, states,
derivatives of the continuous states, event indicators. A parameter of the model is named
`parameters.NAME`, a state `states.NAME`, its derivative `der(states.NAME)`. An FMU with an example
motion has one more parameter, `example.scale`, after those of the model.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as ET

import casadi as ca

from firmware_py import __version__
from firmware_py.core import signals
from firmware_py.core.motion import STUDY_PERIOD_S
from firmware_py.core.signals import PERIOD_S
from firmware_py.core.units import VALUE_UNITS
from fmu.relations import SAMPLE_S, Derivatives, Relations, relations_of
from models.plant.simulation.model_c import FUNCTIONS, without_null_tests, write_model_c
from models.plant.step_model import StepModel, Variable
from models.trials.units import base_exponents

Causality = Literal["independent", "input", "parameter", "output", "local"]
FmiVersion = Literal[2, 3]

STOP_TIME_S = 2 * 256 * PERIOD_S
"""Default stop time: two cycles of the study's motion (paper, section IV-A)."""

_BOOLEANS = {signals.IN_RANGE.name}

_EXAMPLE_SCALE = Variable(
    "example.scale", "1", 1.0, "Size of the motion that the FMU makes by itself until the host "
    "sets one of its moving inputs; 0: it rests", 0.0, 1.0,
)  # fmt: skip

_INITIAL = {"parameter": "exact", "output": "calculated", "local": "calculated"}

Dependencies = dict[int, tuple[int, ...]]
"""References of the knowns on which each unknown depends."""


@dataclass(frozen=True, kw_only=True)
class FmiVariable(Variable):
    """Scalar variable of an FMU; `sampled`: it changes only at events of Model Exchange."""

    reference: int  # Value reference, the row of the table
    causality: Causality
    # Reference of the continuous state of which the variable is the derivative
    derivative_of: int | None = None

    @property
    def type(self) -> Literal["Float64", "Boolean"]:
        """Name of the type in FMI 3.0."""
        return "Boolean" if self.name in _BOOLEANS else "Float64"

    @property
    def variability(self) -> str:
        """How the value may change over time."""
        if self.causality == "parameter":
            return "tunable"
        return "discrete" if self.sampled else "continuous"

    @property
    def bounds(self) -> dict[str, float]:
        """Finite bounds by their FMI names, "min" and "max"."""
        pair = {"min": self.minimum, "max": self.maximum}
        return {name: value for name, value in pair.items() if math.isfinite(value)}


@dataclass(frozen=True)
class Interface:
    """Variables of an FMU and what each depends on."""

    name: str  # Model identifier, a C identifier
    variables: tuple[FmiVariable, ...]  # The index is the value reference
    relations: Relations  # Continuous states, event indicators and derivatives of the model
    # References of the inputs, parameters and continuous states on which each output, derivative
    # and event indicator depends directly
    dependencies: Dependencies
    # References of the inputs and parameters on which each output, state and derivative depends in
    # initialization mode
    initial_dependencies: Dependencies
    # Amplitude of the example motion for each input; empty if there is none
    example: tuple[float, ...] = ()

    def of(self, causality: Causality) -> tuple[FmiVariable, ...]:
        return tuple(v for v in self.variables if v.causality == causality)

    @property
    def continuous_states(self) -> tuple[FmiVariable, ...]:
        """Continuous states, in the order of their vector."""
        return tuple(self.variables[v.derivative_of] for v in self.derivatives)  # type: ignore[index]

    @property
    def derivatives(self) -> tuple[FmiVariable, ...]:
        return tuple(v for v in self.variables if v.derivative_of is not None)

    @property
    def indicators(self) -> tuple[FmiVariable, ...]:
        return self.variables[len(self.variables) - self.relations.indicators :]


def interface_of(
    model: StepModel, derivatives: Derivatives = "both", example: Sequence[float] = ()
) -> Interface:
    """Derive the variable table and the dependencies of a model.

    `example` gives the amplitude of the example motion for each input; empty for none.
    """
    relations = relations_of(model, derivatives)
    variables = tuple(_numbered(model, relations, with_example=bool(example)))
    first_parameter = 1 + len(model.inputs)
    first_output = first_parameter + len(model.parameters) + bool(example)
    first_state = first_output + len(model.outputs)
    known = [
        {k: first_state + k for k in relations.continuous},
        {k: 1 + k for k in range(len(model.inputs))},
        {k: first_parameter + k for k in range(len(model.parameters))},
    ]
    first_derivative = first_state + len(model.states)
    rate, indicators = relations.functions["rate"], relations.functions["indicators"]
    now = {
        **_dependencies(model.output, first_output, known),
        **_dependencies(rate, first_derivative, known),
        **_dependencies(indicators, first_derivative + len(relations.continuous), known),
    }
    _, u, p = (ca.MX.sym(label, rate.size1_in(k)) for k, label in enumerate("xup"))
    start = model.initial(u, p)
    initial: Dependencies = {}
    for function, row in ((model.output, first_output), (rate, first_derivative)):
        composed = ca.Function("composed", [u, p], [function(start, u, p)])
        initial |= _dependencies(composed, row, known[1:])
    state = _dependencies(model.initial, first_state, known[1:])
    initial |= {first_state + k: state[first_state + k] for k in relations.continuous}
    return Interface(
        model.name, variables, relations, now, dict(sorted(initial.items())), tuple(example)
    )


def _numbered(
    model: StepModel, relations: Relations, *, with_example: bool
) -> Iterator[FmiVariable]:
    """Yield the variables in the order of their references."""
    time = Variable(signals.TIME.name.removesuffix("_s"), "s", description="simulation time")
    states = [
        replace(v, name=f"states.{v.name}", sampled=k not in relations.continuous,
                description=v.description or "state of the plant")
        for k, v in enumerate(model.states)
    ]  # fmt: skip
    discrete = _discrete_rows(model, relations)
    outputs = [
        replace(v, sampled=v.sampled or relations.sampled or v.name in _BOOLEANS or k in discrete)
        for k, v in enumerate(model.outputs)
    ]
    rates = [states[k] for k in relations.continuous]
    parameters = [replace(v, name=f"parameters.{v.name}") for v in model.parameters]
    groups: tuple[tuple[Causality, Sequence[Variable]], ...] = (
        ("independent", [time]),
        ("input", model.inputs),
        ("parameter", [*parameters, *([_EXAMPLE_SCALE] if with_example else [])]),
        ("output", outputs),
        ("local", states),
        ("local", [Variable(f"der({v.name})", _per_second(v.unit)) for v in rates]),
        ("local", [_indicator(k + 1) for k in range(relations.indicators)]),
    )
    first_state = sum(len(group) for _, group in groups[:4])
    first_derivative = first_state + len(states)
    numbered = ((causality, v) for causality, group in groups for v in group)
    for reference, (causality, v) in enumerate(numbered):
        place = reference - first_derivative
        yield FmiVariable(
            **asdict(v) | {"nominal": abs(v.nominal) or 1.0},
            reference=reference,
            causality=causality,
            derivative_of=(
                first_state + relations.continuous[place] if 0 <= place < len(rates) else None
            ),
        )


def _discrete_rows(model: StepModel, relations: Relations) -> set[int]:
    """Outputs that depend only on discrete states, and so change only at events."""
    moving = set(relations.continuous)
    changing = set()
    for argument in (0, 1):
        rows, columns = model.output.jac_sparsity(0, argument).get_triplet()
        pairs = zip(rows, columns, strict=True)
        changing |= {row for row, column in pairs if argument or column in moving}
    return set(range(len(model.outputs))) - changing


def _per_second(unit: str) -> str:
    return f"{unit}2" if unit.endswith("/s") else f"{unit}/s"


def _indicator(number: int) -> Variable:
    description = "changes its sign where a limit (saturation, end stop) is reached or left"
    return Variable(f"indicators.limit_{number}", "1", description=description)


def _dependencies(
    function: ca.Function, first: int, known: Sequence[Mapping[int, int]]
) -> Dependencies:
    """Structural dependencies of a function's rows on the known entries of its arguments."""
    table: dict[int, list[int]] = {first + row: [] for row in range(function.size1_out(0))}
    for argument, references in enumerate(known):
        rows, columns = function.jac_sparsity(0, argument).get_triplet()
        for row, column in zip(rows, columns, strict=True):
            if column in references:
                table[first + row].append(references[column])
    return {unknown: tuple(sorted(knowns)) for unknown, knowns in table.items()}


# ---- C ------------------------------------------------------------------------------------------


def write_equations(model: StepModel, interface: Interface, directory: Path) -> Path:
    """Write `model.c` and `model.h`: the equations of the model and of its relations.

    They use the functions of `fmu_math.h` instead of the C library's sine and so on, for the same
    bits on every platform. The core passes all arguments and results, so no test for NULL is left.
    """
    model_c = write_model_c(model, directory, interface.relations.functions)
    text = model_c.read_text(encoding="utf-8")
    text = f'#include "fmu_math.h"\n{without_null_tests(text)}'
    model_c.write_text(text, encoding="utf-8", newline="\n")
    return model_c


def write_variables(model: StepModel, interface: Interface, token: str, directory: Path) -> Path:
    (directory / "variables.h").write_text(
        _header(model, interface, token), encoding="utf-8", newline="\n"
    )
    (directory / "variables.c").write_text(_table(interface), encoding="utf-8", newline="\n")
    return directory / "variables.c"


def _header(model: StepModel, interface: Interface, token: str) -> str:
    relations = interface.relations
    counts = [len(interface.of(group)) for group in ("input", "parameter", "output")]
    first = accumulate([1, *counts, len(model.states), len(relations.continuous)])
    groups = ("INPUT", "PARAMETER", "OUTPUT", "STATE", "DERIVATIVE", "INDICATOR")
    sizes: dict[str, int | str] = {
        "N_VARIABLES": len(interface.variables),
        "N_STATES": len(model.states),
        **{f"FIRST_{group}": place for group, place in zip(groups, first, strict=True)},
        "SAMPLED": int(relations.sampled),
        "WITH_EXAMPLE": int(bool(interface.example)),
        "WITH_FORWARD": int(relations.derivatives != "none"),
        "WITH_REVERSE": int(relations.derivatives == "both"),
        **_work(relations),
    }
    lines = [
        f"/* Generated for {interface.name}: sizes. */",
        "#ifndef VARIABLES_H",
        "#define VARIABLES_H",
        "",
        f'#define FMU_TOKEN "{token}"',
        f"#define MAX_SUBSTEP_S {_number(model.max_substep_s)}",
        f"#define SAMPLE_S {_number(SAMPLE_S)}",
        f"#define EXAMPLE_PERIOD_S {_number(STUDY_PERIOD_S)}",
        *(f"#define {name} {value}" for name, value in sizes.items()),
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _work(relations: Relations) -> dict[str, str]:
    """Sizes of the work memory as constant expressions of C: the largest need of any function.

    The size of a union is that of its largest member.
    """
    functions = [*FUNCTIONS, *relations.functions]
    kinds = {"ARGUMENTS": "ARG", "RESULTS": "RES", "INTEGERS": "IW", "REALS": "W"}
    sizes = {}
    for name, kind in kinds.items():
        members = " \\\n    ".join(f"char {f}[1 + model_{f}_SZ_{kind}];" for f in functions)
        sizes[f"WORK_{name}"] = f"(sizeof(union {{ \\\n    {members} \\\n}}))"
    return sizes


def _table(interface: Interface) -> str:
    rows = [
        f'    {{"{v.name}", {v.type.upper()}, {v.causality.upper()}, {int(v.sampled)}, '
        f"{_number(v.start)}, {_number(v.minimum)}, {_number(v.maximum)}}},"
        for v in interface.variables
    ]
    places = interface.relations.continuous or (0,)
    example = interface.example or (0.0,) * max(1, len(interface.of("input")))
    nominals = [v.nominal for v in interface.continuous_states] or [1.0]
    return "\n".join(
        [
            f"/* Generated for {interface.name}. */",
            "#include <math.h>",
            "",
            '#include "fmu_core.h"',
            "",
            "/* Name, type, causality, whether it is sampled, start, min, max. */",
            "const Variable VARIABLES[N_VARIABLES] = {",
            *rows,
            "};",
            "",
            f"const int CONTINUOUS_STATES[{len(places)}] = {{{', '.join(map(str, places))}}};",
            f"const double NOMINALS[{len(nominals)}] = {{{', '.join(map(_number, nominals))}}};",
            f"const double EXAMPLE[{len(example)}] = {{{', '.join(map(_number, example))}}};",
            "",
        ]
    )


def _number(value: float) -> str:
    """C constant with the same bits."""
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


# ---- XML ----------------------------------------------------------------------------------------


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
    root = ET.Element(
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
    if fmi == 2:
        root.set("numberOfEventIndicators", str(interface.relations.indicators))
    capabilities = _capabilities(interface, fmi)
    completed_step = {2: {"completedIntegratorStepNotNeeded": "true"},
                      3: {"needsCompletedIntegratorStep": "false"}}[fmi]  # fmt: skip
    any_step = {"canHandleVariableCommunicationStepSize": "true"}
    interface_types = [
        ET.SubElement(root, "ModelExchange", capabilities | completed_step),
        ET.SubElement(root, "CoSimulation", capabilities | any_step),
    ]
    root.append(_unit_definitions(interface))
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="refused calls")
    ET.SubElement(
        root, "DefaultExperiment",
        startTime="0.0", stopTime=repr(STOP_TIME_S), stepSize=repr(PERIOD_S),
    )  # fmt: skip
    variables = ET.SubElement(root, "ModelVariables")
    variables.extend(_variable(variable, fmi) for variable in interface.variables)
    root.append(_structure(interface, fmi))
    if fmi == 2 and sources:
        for interface_type in interface_types:
            files = ET.Element("SourceFiles")
            interface_type.insert(0, files)
            for source in sources:
                ET.SubElement(files, "File", name=source)
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


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
    for name in sorted({v.unit for v in interface.variables if v.type == "Float64"}):
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
    if variable.causality in _INITIAL:
        attributes["initial"] = _INITIAL[variable.causality]
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
        attributes.update({name: repr(value) for name, value in variable.bounds.items()})
        if variable.causality != "independent" and variable.derivative_of is None:
            attributes["nominal"] = repr(variable.nominal)
    if variable.causality in ("input", "parameter"):
        attributes["start"] = repr(float(variable.start))
    return attributes


def _variable(variable: FmiVariable, fmi: FmiVersion) -> ET.Element:
    tag: str = variable.type if fmi == 3 else "ScalarVariable"
    element = value = ET.Element(tag, _common(variable))
    if fmi == 2:
        value = ET.SubElement(element, {"Float64": "Real", "Boolean": "Boolean"}[variable.type])
    value.attrib |= _values(variable)
    if variable.derivative_of is not None:
        value.set("derivative", str(variable.derivative_of + (fmi == 2)))
    return element


def _structure(interface: Interface, fmi: FmiVersion) -> ET.Element:
    """Model structure.

    In FMI 2.0 indices begin at 1, unknowns stand in groups, and parameters are knowns only
    initially.
    """
    structure = ET.Element("ModelStructure")
    now, initial = interface.dependencies, interface.initial_dependencies
    parameters = {v.reference for v in interface.of("parameter")}
    parts: tuple[tuple[str, str, Sequence[int], Dependencies], ...] = (
        ("Outputs", "Output", [v.reference for v in interface.of("output")], now),
        ("Derivatives", "ContinuousStateDerivative",
         [v.reference for v in interface.derivatives], now),
        ("InitialUnknowns", "InitialUnknown", list(initial), initial),
        ("", "EventIndicator", [v.reference for v in interface.indicators], now),
    )  # fmt: skip
    for group_2, tag_3, unknowns, table in parts:
        if fmi == 3:
            for unknown in unknowns:
                knowns = " ".join(map(str, table[unknown]))
                ET.SubElement(structure, tag_3, valueReference=str(unknown), dependencies=knowns)
        elif group_2 and unknowns:
            group = ET.SubElement(structure, group_2)
            for unknown in unknowns:
                of = [k for k in table[unknown] if table is initial or k not in parameters]
                knowns = " ".join(str(k + 1) for k in of)
                ET.SubElement(group, "Unknown", index=str(unknown + 1), dependencies=knowns)
    return structure
