"""Restart of a model that is driven by measurement, at samples that cannot continue its past.

Some samples follow from no motion of a servo: a start far from zero whose first angle comes with
the first step, or an encoder that jumps. Taken as a motion, a jump of 4 rad bends the link beyond
every limit, and all later steps fail. Instead, joints and load restart at rest at the sample.
Estimates from before the jump, such as the payload, are kept.

At a state that no link can have, everything restarts at the end of the step, the estimates too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import casadi as ca

from firmware_py.signals import PERIOD_S
from models.plant.scope import Expr, Scope
from models.plant.step_model import StepModel

JUMP_RAD_S: Final = 10.0
"""Rate above which a measured angle jumps: 13 times the peak rate of the study's
motion, 30° at 4.352 s. [assumed]"""

LARGEST_BEND_RAD: Final = math.pi
"""Bend of a hinge at which the link lies on itself."""

LARGEST_STATE: Final = 1e100
"""Sum of the magnitudes of all states above which the next step may overflow."""


def restart_where_impossible(
    model: StepModel, scope: Scope, resting: Sequence[Expr], jump: Expr
) -> StepModel:
    """Add the restarts to a model.

    `resting` is the state at rest at the sample, in the order of the model's states. `jump` says
    whether the sample cannot continue the past (`is_jump`).
    """
    x, u, p = (
        ca.vertcat(*(s.symbol for s in scope.states.values())),
        ca.vertcat(*(symbol for _, symbol in scope.inputs.values())),
        ca.vertcat(*(symbol for _, symbol in scope.parameters.values())),
    )
    bends = [ca.fabs(bend) <= LARGEST_BEND_RAD for bend in scope.bend.values()]
    size = sum(ca.fabs(s.symbol) for s in scope.states.values())
    possible = ca.Function("possible", [x], [_all([*bends, size <= LARGEST_STATE])])
    jumps = ca.Function("jumps", [x, u, p, scope.step_s], [jump])
    column = ca.cse(ca.densify(ca.vertcat(*(ca.SX(value) for value in resting))))
    rest = ca.Function("rest", [x, u, p], [column])

    x, u, p = (ca.MX.sym(label, model.begin.size_in(k)) for k, label in enumerate("xup"))
    arguments = (x, u, p, ca.MX.sym("h"))
    labels = ["x", "u", "p", "h"]
    # Only the chosen branch is computed, so a step without a restart costs nothing.
    before = ca.if_else(jumps(*arguments), rest(x, u, p), x, True)
    after = model.finish(*arguments)
    kept = ca.if_else(possible(after), after, model.initial(u, p), True)
    begun = model.begin(before, *arguments[1:])
    return replace(
        model,
        begin=ca.Function(model.begin.name(), arguments, [begun], labels, ["result"]),
        finish=ca.Function(model.finish.name(), arguments, [kept], labels, ["result"]),
    )


def is_jump(scope: Scope) -> Expr:
    """Whether any measured angle has changed faster than `JUMP_RAD_S` since the last sample.

    In steps shorter than the control period, an angle may change as much as in a control period: a
    host with small steps holds the robot's samples, which arrive once per period.
    """
    angle = scope.suffix["angle"]
    ramps = [scope.states[f"ramp_{j}_{angle}"] for j in scope.joints]
    limit = JUMP_RAD_S * ca.fmax(scope.step_s, PERIOD_S)
    return 1 - _all([ca.fabs(ramp.finish - ramp.symbol) <= limit for ramp in ramps])


def _all(conditions: Sequence[Expr]) -> Expr:
    """1 if all conditions hold, else 0; a comparison with NaN does not hold."""
    result: Expr = 1
    for condition in conditions:
        result = ca.logic_and(result, condition)
    return result
