"""Current sampled at a phase of the step: its smooth part between two ends of steps.

The drive adds the saw-tooth of a goal that jumps (`models.plant.components.drives.goal_shape`).
What remains moves little within a step, so a line between the currents at both ends is taken.
"""

from __future__ import annotations

from models.plant.scope import Expr, Scope, substitute
from models.plant.step_model import Variable


def current_at_phase(scope: Scope, joint: int, current: Expr) -> Expr:
    """Current at `current_phase` of the step; the one given where the drive has no such parameter.

    Parameters
    ----------
    scope : Scope
        Composed: the initial value of every state is set.
    joint : int
        Number of the joint.
    current : SX
        Current at the end of the step.
    """
    name = f"current_phase_{joint}"
    if name not in scope.parameters:
        return current
    phase = scope.p("current_phase_{j}", joint)
    still = [(s.symbol, s.initial) for s in scope.states.values()]
    before = scope.state(Variable(f"current_before_{joint}_a", "A"), substitute(current, still))
    scope.states[before.name()].begin = current
    return phase * current + (1 - phase) * before
