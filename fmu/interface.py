"""Variable table of an FMU: the one source of its C, its XML, its documentation and its tests.

Value references number the variables in this order: time, inputs, parameters, outputs. A parameter
of the model is named `parameters.NAME`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca

from firmware_py import signals
from models.plant.step_model import StepModel, Variable

Causality = Literal["independent", "input", "parameter", "output"]

_BOOLEANS = {signals.IN_RANGE.name}
_VARIABILITY = {"parameter": "tunable"}


@dataclass(frozen=True)
class FmiVariable:
    """Scalar variable of an FMU.

    Attributes
    ----------
    reference : int
        Value reference, the row of the table.
    causality : str
        "independent", "input", "parameter" or "output".
    type : str
        "Float64" or "Boolean" (FMI 3.0 names).
    name, unit, start, minimum, maximum, nominal, description
        As in `models.plant.step_model.Variable`, from which it is made.
    """

    reference: int
    causality: Causality
    type: Literal["Float64", "Boolean"]
    name: str
    unit: str
    start: float
    minimum: float
    maximum: float
    nominal: float
    description: str

    @property
    def variability(self) -> str:
        """How the value may change over time."""
        default = "discrete" if self.type == "Boolean" else "continuous"
        return _VARIABILITY.get(self.causality, default)

    @property
    def initial(self) -> str | None:
        """How the variable gets its first value; inputs and time have no such attribute."""
        return {"parameter": "exact", "output": "calculated"}.get(self.causality)


@dataclass(frozen=True)
class Interface:
    """External interface of an FMU.

    Attributes
    ----------
    name : str
        Model identifier, a C identifier.
    variables : tuple of FmiVariable
        The index is the value reference.
    dependencies, initial_dependencies : dict of int to tuple of int
        For each output the references of the inputs and parameters on which it depends directly,
        at a communication point and in initialization mode.
    """

    name: str
    variables: tuple[FmiVariable, ...]
    dependencies: dict[int, tuple[int, ...]]
    initial_dependencies: dict[int, tuple[int, ...]]

    def of(self, causality: Causality) -> tuple[FmiVariable, ...]:
        """Variables of one causality, in order."""
        return tuple(v for v in self.variables if v.causality == causality)

    @property
    def units(self) -> tuple[str, ...]:
        """Every SI unit in use, sorted."""
        return tuple(sorted({v.unit for v in self.variables if v.type == "Float64"}))


def interface_of(model: StepModel) -> Interface:
    """Derive the variable table and the dependencies of a model.

    Parameters
    ----------
    model : StepModel
        Its name becomes the model identifier.
    """
    time = Variable(signals.TIME.name.removesuffix("_s"), "s", description="simulation time")
    parameters = [Variable(**{**vars(v), "name": f"parameters.{v.name}"}) for v in model.parameters]
    groups: tuple[tuple[Causality, Sequence[Variable]], ...] = (
        ("independent", [time]),
        ("input", model.inputs),
        ("parameter", parameters),
        ("output", model.outputs),
    )
    variables = tuple(_number(groups))
    first = {causality: _first(variables, causality) for causality, _ in groups}
    known = (first["input"], first["parameter"], first["output"])
    return Interface(
        model.name,
        variables,
        _dependencies(model.output, (1, 2), known),
        _dependencies(_initial_output(model), (0, 1), known),
    )


def _number(groups: Sequence[tuple[Causality, Sequence[Variable]]]) -> Iterator[FmiVariable]:
    reference = 0
    for causality, variables in groups:
        for v in variables:
            kind: Literal["Float64", "Boolean"] = "Boolean" if v.name in _BOOLEANS else "Float64"
            yield FmiVariable(
                reference, causality, kind, v.name, v.unit, v.start, v.minimum, v.maximum,
                abs(v.nominal) or 1.0, v.description,
            )  # fmt: skip
            reference += 1


def _first(variables: Sequence[FmiVariable], causality: Causality) -> int:
    """First reference of a causality; if it has no variables, the reference of the next one."""
    order = ("independent", "input", "parameter", "output")
    return sum(order.index(v.causality) < order.index(causality) for v in variables)


def _initial_output(model: StepModel) -> ca.Function:
    """Outputs in initialization mode: (u, p) -> y."""
    u, p = ca.MX.sym("u", len(model.inputs)), ca.MX.sym("p", len(model.parameters))
    return ca.Function("initial_output", [u, p], [model.output(model.initial(u, p), u, p)])


def _dependencies(
    function: ca.Function, arguments: tuple[int, int], first: tuple[int, int, int]
) -> dict[int, tuple[int, ...]]:
    """Structural dependencies of the outputs on inputs and parameters, by value reference."""
    first_input, first_parameter, first_output = first
    found: dict[int, list[int]] = {first_output + row: [] for row in range(function.size1_out(0))}
    for argument, offset in zip(arguments, (first_input, first_parameter), strict=True):
        rows, columns = function.jac_sparsity(0, argument).get_triplet()
        for row, column in zip(rows, columns, strict=True):
            found[first_output + row].append(offset + column)
    return {output: tuple(sorted(known)) for output, known in found.items()}


def finite_bounds(variable: FmiVariable) -> dict[str, float]:
    """Return the finite bounds of a variable by their FMI names, "min" and "max".

    Parameters
    ----------
    variable : FmiVariable
        Bounds that are infinite are left out.
    """
    pair = {"min": variable.minimum, "max": variable.maximum}
    return {name: value for name, value in pair.items() if math.isfinite(value)}
