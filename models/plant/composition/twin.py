"""Put drive, load and effects together into a `StepModel`.

The twin is the plant in closed loop: goals in, everything measured out. Its joints are states.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import casadi as ca

from firmware_py.signals import PAYLOAD
from models.plant.components.drives import UNIT_OF, Drive, mesh
from models.plant.components.lagrange import solve
from models.plant.effects import Effect
from models.plant.scope import Expr, Scope, substitute
from models.plant.step_model import StepModel, Variable, runge_kutta

MAX_SUBSTEP_S: Final = 1e-3
"""Longest Runge–Kutta step: dry friction is stiff."""


def compose_twin(
    name: str, scope: Scope, drive: Drive, load: Any, effects: Sequence[Effect]
) -> StepModel:
    """Plant in closed loop; see the module's text."""
    serve(scope, ("sensor",), effects)
    drive.declare(scope)
    scope.payload_kg = scope.input(payload_variable())
    for j in scope.joints:
        declare_joint(scope, j, scope.start[j])
        if drive.meshes:
            mesh(scope, j)
    load.declare(scope)
    serve(scope, ("command",), effects)
    strain(scope, load, effects)
    drive.drive(scope)
    for j, pressing in scope.pressing.items():
        scope.friction[j] = substitute(scope.friction[j], [(pressing, scope.motor_torque[j])])
    mass, force = load.equations(scope)
    lost = mass[:, : len(scope.joints)] @ ca.vertcat(*scope.windup_acceleration.values())
    torque = []
    for index, j in enumerate(scope.joints):
        mass[index, index] += drive.inertia(scope, j)
        torque.append(scope.motor_torque[j] - scope.friction[j] + scope.joint_torque[j])
    torque = ca.vertcat(*torque, *scope.bend_torque.values())
    acceleration = ca.vertsplit(solve(mass, torque - force + lost))
    rates = (*scope.rate.values(), *scope.bend_rate.values())
    for rate, value in zip(rates, acceleration, strict=True):
        scope.states[rate.name()].rate = value
    settle(scope, load, force)
    outputs: dict[str, tuple[Variable, Expr]] = {}
    angle = scope.suffix["angle"]
    for j in scope.joints:
        variable = Variable(
            f"{JOINT[angle]}_{j}_{angle}", UNIT_OF[angle], 0.0, f"measured, joint {j}"
        )
        outputs[variable.name] = (variable, scope.seen_angle(j))
    for j, current in scope.current.items():
        variable = current_variable(j)
        outputs[variable.name] = (variable, measured_current(scope, j, current))
    return build(name, scope, outputs | load.outputs(scope))


JOINT: Final = {"rad": "angle", "m": "position"}
"""What the coordinate of a joint is called, by its unit."""


def payload_variable(start: float = 0.0) -> Variable:
    """Mass at the tip as an input or output."""
    return Variable(PAYLOAD.name, PAYLOAD.unit, start, PAYLOAD.description, 0.0, 3.0)


def current_variable(joint: int) -> Variable:
    """Motor current as an input or output."""
    return Variable(f"current_{joint}_a", "A", 0.0, f"measured motor current of joint {joint}")


def measured_current(scope: Scope, joint: int, current: Expr) -> Expr:
    """Motor current as the sensor shows it."""
    return (1 + scope.current_scale[joint]) * current + scope.current_bias[joint]


def declare_joint(scope: Scope, joint: int, initial: Expr) -> None:
    """Add the coordinate of a joint and its rate as states."""
    angle = scope.suffix["angle"]
    unit = UNIT_OF[angle]
    scope.angle[joint] = scope.state(Variable(f"joint_{joint}_{angle}", unit, nominal=0.5), initial)
    scope.rate[joint] = scope.state(Variable(f"joint_rate_{joint}_{angle}_s", f"{unit}/s"))
    scope.states[f"joint_{joint}_{angle}"].rate = scope.rate[joint]


def serve(scope: Scope, ports: Iterable[str], effects: Sequence[Effect]) -> None:
    """Let the effects of each port act, port by port."""
    for port in ports:
        for effect in effects:
            if effect.port == port:
                effect.apply(scope)


def strain(scope: Scope, load: Any, effects: Sequence[Effect]) -> None:
    """Wire every torque but the drive's: on the bends, on the joint and through the gear."""
    serve(scope, ("stiffness", "mass"), effects)
    load.load(scope)
    serve(scope, ("bend_torque", "joint_torque"), effects)
    load.transmit(scope)
    serve(scope, ("servo_torque",), effects)


NEWTON_STEPS: Final = 3
"""From the straight link to where it rests: stiffness may depend on a bend."""

LARGEST_START_RAD: Final = 0.5
"""A link too weak to stand starts folded by no more than this."""


def settle(scope: Scope, load: Any, force: Expr) -> None:
    """Start at rest: bends in equilibrium at the first goal, the drive holding the load.

    The equilibrium is `NEWTON_STEPS` from the straight link. The bend at rest where the encoders
    show upright is the reference of the Deformation Index.
    """
    bends = [scope.states[b.name()] for b in scope.bend.values()]
    symbols = ca.vertcat(*(b.symbol for b in bends))
    count = len(scope.joints)
    residual = ca.vertcat(*scope.bend_torque.values()) - force[count:, :]

    def at_rest(expression: Expr, angles: Sequence[Expr]) -> Expr:
        """Expression with all at rest; states that start with a bend follow it."""
        own = {s.name() for s in (*scope.angle.values(), *scope.bend.values())}
        still = [(s.symbol, s.initial) for n, s in scope.states.items() if n not in own]
        expression = substitute(expression, still)
        return substitute(expression, list(zip(scope.angle.values(), angles, strict=True)))

    def equilibrium(angles: Sequence[Expr]) -> Expr:
        balance = at_rest(residual, angles)
        slope = ca.jacobian(balance, symbols)
        bend = ca.SX.zeros(symbols.numel())
        for _ in range(NEWTON_STEPS):
            here = [(symbols, bend)]
            bend = bend + solve(-substitute(slope, here), substitute(balance, here))
            bend = ca.fmin(ca.fmax(bend, -LARGEST_START_RAD), LARGEST_START_RAD)
        return bend

    start = [scope.states[a.name()].initial for a in scope.angle.values()]
    first = equilibrium(start) if bends else ca.SX(0, 1)
    shown = [ca.SX(-scope.angle_error[j]) for j in scope.joints]
    upright = equilibrium(shown) if bends else ca.SX(0, 1)
    for key, value in zip(scope.bend, ca.vertsplit(upright), strict=True):
        scope.rest_bend[key] = value
    holding = force[:count] - ca.vertcat(*scope.joint_torque.values())
    holding = substitute(at_rest(holding, start), [(symbols, first)])
    for state, value in zip(bends, ca.vertsplit(first), strict=True):
        state.initial = value
    held = list(zip(scope.holding.values(), ca.vertsplit(holding), strict=True))
    for state in scope.states.values():
        state.initial = substitute(substitute(state.initial, [(symbols, first)]), held)


def build(
    name: str,
    scope: Scope,
    outputs: dict[str, tuple[Variable, Expr]],
    max_substep_s: float = MAX_SUBSTEP_S,
) -> StepModel:
    """Make the functions of a `StepModel` from what the scope has gathered."""
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
        finish=function("finish", [h], finish),
        output=function("output", [], [expression for _, expression in outputs.values()]),
        max_substep_s=max_substep_s,
        rate=rate,
    )
