"""Continuous part of a step model for Model Exchange, and derivatives of its relations.

The relations are functions of state, inputs and parameters (x, u, p)::

    rate        derivatives of the continuous states
    indicators  event indicators: they change their sign where the rate has a kink
    response    outputs, rate and indicators, one below the other
    sample      states after the discrete updates at the begin of a step of SAMPLE_S; after the
                whole step if all of the model is sampled
    initial     states at the start, of (u, p) only

The last three have a forward derivative NAME_forward along a direction, the additional argument
(dx, du, dp). They also have an adjoint derivative NAME_reverse, whose additional argument is a
weight for each row and whose result is (gx, gu, gp); `initial` has none. CasADi derives them from
the expression graph by the forward and the reverse mode [Andersson et al. 2019]. They are most of
an FMU's code. A whole response takes less than its parts, because they share the kinematics.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Final, Literal

import casadi as ca

from firmware_py.core.signals import PERIOD_S
from models.plant.step_model import StepModel

Derivatives = Literal["none", "forward", "both"]
"""Derivatives to write: none, forward ones, or forward and adjoint ones."""

SAMPLE_S: Final = PERIOD_S
"""Time between two samples in Model Exchange, the control period of the robot."""

KINKS: Final = (ca.OP_FMIN, ca.OP_FMAX)
"""Operations at which a rate has a kink: saturation and end stops. |x| is left out: its kink is
where things rest, so an indicator would change its sign endlessly."""

LARGEST_SCALAR: Final = 8000
"""Most operations of a relation that is derived in scalars; the response of a twin with two joints
needs 4000. Predictors with large matrices are derived as matrices."""


@dataclass(frozen=True)
class Relations:
    """Relations of a model, see the module's docstring."""

    # Indices of the continuous states. Empty if all of the model is sampled: a model without a
    # rate, or one whose inputs are measured at the end of a step.
    continuous: tuple[int, ...]
    functions: dict[str, ca.Function]  # Functions by name, without those of the model itself
    indicators: int  # Number of event indicators
    derivatives: Derivatives  # Which derivatives the functions include

    @property
    def sampled(self) -> bool:
        return not self.continuous


def relations_of(model: StepModel, derivatives: Derivatives = "both") -> Relations:
    symbols = _symbols(model, ca.SX)
    rate, kinks = ca.SX(0, 1), ca.SX(0, 1)
    continuous: tuple[int, ...] = ()
    if model.rate is not None and not model.inputs_at_end:
        full = model.rate(*symbols)
        continuous = tuple(k for k in range(full.numel()) if not full[k].is_zero())
        rate, kinks = full[list(continuous)], ca.vertcat(*_kinks(model.rate, symbols))
    functions = {
        "rate": ca.Function("rate", symbols, [ca.densify(rate)]),
        "indicators": ca.Function("indicators", symbols, [ca.cse(ca.densify(kinks))]),
    }
    x, u, p = _symbols(model, ca.MX)
    if derivatives != "none":
        rows = ca.vertcat(
            model.output(x, u, p), functions["rate"](x, u, p), functions["indicators"](x, u, p)
        )
        derived = {
            "response": _scalar(ca.Function("response", [x, u, p], [rows])),
            "sample": (
                _scalar(_sample(model, whole=False)) if continuous else _sample(model, whole=True)
            ),
            "initial": _scalar(model.initial),
        }
        for name, function in derived.items():
            functions[f"{name}_forward"] = _forward(function)
            if derivatives == "both" and name != "initial":
                functions[f"{name}_reverse"] = _reverse(function)
    if model.rate is not None and continuous:  # in C, the function that the flow calls
        rows = model.rate(x, u, p)[list(continuous)]
        functions["rate"] = ca.Function("rate", [x, u, p], [rows])
    return Relations(continuous, functions, kinks.numel(), derivatives)


def _sample(model: StepModel, *, whole: bool) -> ca.Function:
    """States after the discrete updates at the begin of a step of SAMPLE_S, or after all of it."""
    x, u, p = _symbols(model, ca.MX)
    after = model.begin(x, u, p, SAMPLE_S)
    if whole:
        count = math.ceil(SAMPLE_S / model.max_substep_s - 1e-9)
        for _ in range(count):
            after = model.flow(after, u, p, SAMPLE_S / count)
        after = model.finish(after, u, p, SAMPLE_S)
    return ca.Function("sample", [x, u, p], [after])


def _scalar(function: ca.Function) -> ca.Function:
    """Function in scalar operations without duplicates; unchanged if there are too many."""
    expanded = function.expand()
    if expanded.n_instructions() > LARGEST_SCALAR:
        return function
    arguments = [ca.SX.sym(f"i{k}", *function.size_in(k)) for k in range(function.n_in())]
    return ca.Function("scalar", arguments, [ca.cse(expanded(*arguments))])


def _symbols(model: StepModel, kind: Any) -> list[Any]:
    sizes = len(model.states), len(model.inputs), len(model.parameters)
    return [kind.sym(label, size) for label, size in zip("xup", sizes, strict=True)]


def _kinks(function: ca.Function, arguments: list[Any]) -> Iterable[Any]:
    """Difference of the two arguments of each operation of `KINKS`, by running the instructions."""
    work: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        given, out = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[out[0]] = arguments[given[0]][given[1]]
        elif operation == ca.OP_CONST:
            work[out[0]] = ca.SX(function.instruction_constant(k))
        elif operation != ca.OP_OUTPUT:
            values = [work[i] for i in given]
            if operation in KINKS:
                yield values[0] - values[1]
            apply = ca.SX.unary if len(values) == 1 else ca.SX.binary
            work[out[0]] = apply(operation, *values)


def _forward(function: ca.Function) -> ca.Function:
    """Function (…, direction) -> derivative along the direction."""
    kind, arguments = _arguments(function)
    direction = kind.sym("direction", sum(a.numel() for a in arguments))
    if kind is ca.SX:
        value = function(*arguments)
        slope = ca.cse(ca.jtimes(value, ca.vertcat(*arguments), direction))
    else:
        places = [0, *accumulate(a.numel() for a in arguments)]
        unused: Any = ca.MX(*function.size_out(0))  # only functions that are solved need the result
        slope = function.forward(1)(*arguments, unused, *ca.vertsplit(direction, places))
    return ca.Function("forward", [*arguments, direction], [ca.densify(slope)])


def _reverse(function: ca.Function) -> ca.Function:
    """Function (…, weights) -> gradient of the weighted sum with respect to all arguments."""
    kind, arguments = _arguments(function)
    weight = kind.sym("weight", function.size1_out(0))
    if kind is ca.SX:
        value = function(*arguments)
        gradient = ca.cse(ca.jtimes(value, ca.vertcat(*arguments), weight, True))
    else:
        unused: Any = ca.MX(*function.size_out(0))
        parts = function.reverse(1)(*arguments, unused, weight)
        gradient = ca.vertcat(*(parts if isinstance(parts, (tuple, list)) else [parts]))
    return ca.Function("reverse", [*arguments, weight], [ca.densify(gradient)])


def _arguments(function: ca.Function) -> tuple[Any, list[Any]]:
    """Kind of a function's symbols, and one symbol for each argument."""
    kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    return kind, [kind.sym(f"i{k}", *function.size_in(k)) for k in range(function.n_in())]
