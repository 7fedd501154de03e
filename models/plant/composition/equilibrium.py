"""Initial state of a composed plant: at rest, bends in equilibrium, load held by the drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import casadi as ca

from models.plant.components.lagrange import solve_symmetric
from models.plant.scope import Expr, Scope, substitute

NEWTON_STEPS: Final = 3
"""Newton steps from the straight link to the equilibrium; stiffness may depend on the bend."""

LARGEST_START_RAD: Final = 0.5
"""Limit of a bend in each Newton step: a weak link has no equilibrium near zero."""


def start_in_motion(scope: Scope) -> None:
    """Set the initial value of every state that has a parameter `start_STATE`; call it last."""
    for name, state in scope.states.items():
        if f"start_{name}" in scope.parameters:
            state.initial = scope.p(f"start_{name}")


def set_initial_equilibrium(scope: Scope, force: Expr) -> None:
    """Set the initial value of every state, and `rest_bend`.

    The joints rest at the first goal, the bends are in equilibrium there (`NEWTON_STEPS` from the
    straight link), and the drive holds the load. `rest_bend` is the equilibrium at encoder readings
    of zero (upright), the reference of the Deformation Index. `force` holds velocity and gravity
    forces over the joints' coordinates and the bends.
    """
    for state in scope.states.values():  # a state may start at another, e.g. the shaped goal
        state.initial = scope.initial_value(state.initial)
    bends = [scope.states[b.name()] for b in scope.bend.values()]
    symbols = ca.vertcat(*(b.symbol for b in bends))
    count = len(scope.joints)
    residual = ca.vertcat(*scope.bend_torque.values()) - force[count:, :]

    def at_rest(expression: Expr, angles: Sequence[Expr]) -> Expr:
        """Expression with every state except joints and bends at its initial value."""
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
            bend = bend + solve_symmetric(-substitute(slope, here), substitute(balance, here))
            bend = ca.fmin(ca.fmax(bend, -LARGEST_START_RAD), LARGEST_START_RAD)
        return bend

    start = [scope.states[a.name()].initial for a in scope.angle.values()]
    first = equilibrium(start) if bends else ca.SX(0, 1)
    upright_angles = [ca.SX(scope.true_angle(j, 0)) for j in scope.joints]
    upright = equilibrium(upright_angles) if bends else ca.SX(0, 1)
    for key, value in zip(scope.bend, ca.vertsplit(upright), strict=True):
        scope.rest_bend[key] = value
    holding = force[:count] - ca.vertcat(*scope.joint_torque.values())
    holding = substitute(at_rest(holding, start), [(symbols, first)])
    for state, value in zip(bends, ca.vertsplit(first), strict=True):
        state.initial = value
    held = list(zip(scope.holding_torque.values(), ca.vertsplit(holding), strict=True))
    for state in scope.states.values():
        state.initial = substitute(substitute(state.initial, [(symbols, first)]), held)
