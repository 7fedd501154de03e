"""Variable table of an FMU: the single source of its C, XML, documentation and tests.

Value references number the variables in this order: time, inputs, parameters, outputs, states,
derivatives of the continuous states, event indicators. A parameter of the model is named
`parameters.NAME`, a state `states.NAME`, its derivative `der(states.NAME)`. An FMU with an example
motion has one more parameter, `example.scale`, after those of the model.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca

from firmware_py.core import signals
from fmu.relations import Derivatives, Relations, relations_of
from models.plant.step_model import StepModel, Variable

Causality = Literal["independent", "input", "parameter", "output", "local"]

_BOOLEANS = {signals.IN_RANGE.name}

_EXAMPLE_SCALE = Variable(
    "example.scale", "1", 1.0, "Size of the motion that the FMU makes by itself until the host "
    "sets one of its moving inputs; 0: it rests", 0.0, 1.0,
)  # fmt: skip

_INITIAL = {"parameter": "exact", "output": "calculated", "local": "calculated"}

Dependencies = dict[int, tuple[int, ...]]
"""References of the knowns on which each unknown depends."""


@dataclass(frozen=True)
class FmiVariable:
    """Scalar variable of an FMU."""

    reference: int  # Value reference, the row of the table
    causality: Causality
    type: Literal["Float64", "Boolean"]  # Name of the type in FMI 3.0
    # Name and the following fields are those of `models.plant.step_model.Variable`
    name: str
    unit: str
    start: float
    minimum: float
    maximum: float
    nominal: float
    description: str
    # Whether the value changes only at events of Model Exchange, not in continuous time
    sampled: bool = False
    # Reference of the continuous state of which the variable is the derivative
    derivative_of: int | None = None

    @property
    def variability(self) -> str:
        """Attribute `variability`: how the value may change over time."""
        if self.causality == "parameter":
            return "tunable"
        return "discrete" if self.sampled else "continuous"

    @property
    def initial(self) -> str | None:
        """Attribute `initial`, which inputs and time do not have."""
        return _INITIAL.get(self.causality)


@dataclass(frozen=True)
class Interface:
    """External interface of an FMU."""

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
        """Return the variables of one causality, in order."""
        return tuple(v for v in self.variables if v.causality == causality)

    @property
    def units(self) -> tuple[str, ...]:
        """SI units in use, sorted."""
        return tuple(sorted({v.unit for v in self.variables if v.type == "Float64"}))

    @property
    def continuous_states(self) -> tuple[FmiVariable, ...]:
        """Continuous states, in the order of their vector."""
        return tuple(self.variables[v.derivative_of] for v in self.derivatives)  # type: ignore[index]

    @property
    def derivatives(self) -> tuple[FmiVariable, ...]:
        """Derivatives of the continuous states."""
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
    variables = tuple(_number(model, relations, with_example=bool(example)))
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


def _number(model: StepModel, relations: Relations, *, with_example: bool) -> Iterator[FmiVariable]:
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
    reference = 0
    first_state = sum(len(group) for _, group in groups[:4])
    first_derivative = first_state + len(states)
    for causality, variables in groups:
        for v in variables:
            kind: Literal["Float64", "Boolean"] = "Boolean" if v.name in _BOOLEANS else "Float64"
            place = reference - first_derivative
            is_rate = 0 <= place < len(rates)
            yield FmiVariable(
                reference, causality, kind, v.name, v.unit, v.start, v.minimum, v.maximum,
                abs(v.nominal) or 1.0, v.description, v.sampled,
                first_state + relations.continuous[place] if is_rate else None,
            )  # fmt: skip
            reference += 1


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
    found: dict[int, list[int]] = {first + row: [] for row in range(function.size1_out(0))}
    for argument, references in enumerate(known):
        rows, columns = function.jac_sparsity(0, argument).get_triplet()
        for row, column in zip(rows, columns, strict=True):
            if column in references:
                found[first + row].append(references[column])
    return {unknown: tuple(sorted(knowns)) for unknown, knowns in found.items()}


def finite_bounds(variable: FmiVariable) -> dict[str, float]:
    """Return the finite bounds of a variable by their FMI names, "min" and "max"."""
    pair = {"min": variable.minimum, "max": variable.maximum}
    return {name: value for name, value in pair.items() if math.isfinite(value)}
