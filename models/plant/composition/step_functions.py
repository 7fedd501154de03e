"""Step functions of a composed plant, and the variables that its models share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import casadi as ca

from firmware_py.signals import PAYLOAD
from models.plant.scope import Expr, Scope
from models.plant.step_model import StepModel, Variable, runge_kutta

MAX_SUBSTEP_S: Final = 1e-3
"""Longest Runge–Kutta step: dry friction is stiff."""

SMALLEST_STATE: Final = 1e-30
"""Magnitude below which a state is set to zero at the end of a step. A state that decays at rest
would become a subnormal number, which slows the processor (docs/sources.md, "FMI"). No state has a
meaning below it in SI units, and products of ten such states are still normal numbers (2.2e-308 and
above) [assumed]."""

COORDINATE_NAME: Final = {"rad": "angle", "m": "position"}
"""Name of a joint's measured coordinate, by the suffix of its unit."""


def payload_variable(scope: Scope, start: float = 0.0) -> Variable:
    """Payload as an input or output."""
    most_kg = scope.most_payload_kg
    start = min(start, most_kg)
    return Variable(PAYLOAD.name, PAYLOAD.unit, start, PAYLOAD.description, 0.0, most_kg)


def current_variable(joint: int) -> Variable:
    """Motor current as an input or output."""
    description = f"measured motor current of joint {joint}"
    return Variable(f"current_{joint}_a", "A", 0.0, description, sampled=True)


def measured_current(scope: Scope, joint: int, current: Expr) -> Expr:
    """Motor current as the sensor measures it."""
    return (1 + scope.current_scale[joint]) * current + scope.current_bias[joint]


def build_step_model(
    name: str,
    scope: Scope,
    outputs: dict[str, tuple[Variable, Expr]],
    max_substep_s: float = MAX_SUBSTEP_S,
    inputs_at_end: bool = False,
) -> StepModel:
    """Build the functions of a `StepModel` from a scope whose states have all values and rates."""
    x = ca.vertcat(*(s.symbol for s in scope.states.values()))
    u = ca.vertcat(*(symbol for _, symbol in scope.inputs.values()))
    p = ca.vertcat(*(symbol for _, symbol in scope.parameters.values()))
    h = scope.step_s

    def function(what: str, extra: Sequence[Expr], rows: Sequence[Expr]) -> Any:
        labels = ["x", "u", "p", "h"][: 3 + len(extra)]
        column = ca.cse(ca.densify(ca.vertcat(*(ca.SX(r) for r in rows))))
        return ca.Function(f"{name}_{what}", [x, u, p, *extra], [column], labels, ["result"])

    states = scope.states.values()
    initial = ca.cse(ca.densify(ca.vertcat(*(ca.SX(s.initial) for s in states))))
    begin = [s.symbol if s.begin is None else s.begin for s in states]
    finish = [s.symbol if s.finish is None else s.finish for s in states]
    flushed = [ca.if_else(ca.fabs(value) < SMALLEST_STATE, 0, value) for value in finish]
    rate = function("rate", [], [s.rate for s in states])
    return StepModel(
        name=name,
        inputs=tuple(v for v, _ in scope.inputs.values()),
        parameters=tuple(v for v, _ in scope.parameters.values()),
        states=tuple(s.variable for s in states),
        outputs=tuple(v for v, _ in outputs.values()),
        initial=ca.Function(f"{name}_initial", [u, p], [initial], ["u", "p"], ["x"]),
        begin=function("begin", [h], begin),
        flow=runge_kutta(f"{name}_flow", rate),
        finish=function("finish", [h], flushed),
        smooth_finish=function("smooth_finish", [h], finish),
        output=function("output", [], [expression for _, expression in outputs.values()]),
        max_substep_s=max_substep_s,
        rate=rate,
        inputs_at_end=inputs_at_end,
    )
