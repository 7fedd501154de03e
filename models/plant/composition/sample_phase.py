"""Current sampled at a phase of the step, interpolated between the ends of two steps.

The drive computes the saw-tooth of a goal that jumps
(`models.plant.components.drives.goal_shape`). A low-pass keeps its part in phase at the frequency
of the steps. The rest of the current changes little within a step, so it is interpolated between
the ends of the step. A servo limits the current at every moment, so the sample is clipped to the
sensor's reading at the limit. The motion does not depend on the sample.
"""

from __future__ import annotations

import math

import casadi as ca

from models.plant.components.drives.drive_protocol import current_limit
from models.plant.components.drives.goal_shape import declare_step_length
from models.plant.composition.output_lag import lagged_output
from models.plant.composition.step_functions import current_variable, measured_current
from models.plant.scope import Expr, Scope, substitute
from models.plant.step_model import Variable

Outputs = dict[str, tuple[Variable, Expr]]


def sampled_currents(scope: Scope, outputs: Outputs) -> Outputs:
    """Outputs with every measured current as it is sampled.

    The currents in `outputs` are those at the end of the step, after the low-pass if any.
    """
    result = dict(outputs)
    for j in scope.current:
        name = current_variable(j).name
        variable, value = outputs[name]
        if j in scope.sampled_above:
            above = (1 + scope.current_scale[j]) * scope.sampled_above[j]
            if j in scope.sensor_lag and lagged_output(outputs, j, scope.columns) == name:
                above *= _kept_fraction(scope, scope.sensor_lag[j].time_s)
            value = _within_limit(scope, j, value + above)
            # Clipped again: the line between two samples at the limit may round beyond it.
            value = _within_limit(scope, j, current_at_phase(scope, j, value))
        else:
            value = current_at_phase(scope, j, value)
        result[name] = (variable, value)
    return result


def current_at_phase(scope: Scope, joint: int, current: Expr) -> Expr:
    """Current at `current_phase` of the step; unchanged if the drive has no such parameter."""
    name = f"current_phase_{joint}"
    if name not in scope.parameters:
        return current
    phase = scope.p("current_phase_{j}", joint)
    still = [(s.symbol, s.initial) for s in scope.states.values()]
    before = scope.state(Variable(f"current_before_{joint}_a", "A"), substitute(current, still))
    scope.states[before.name()].begin = current
    return phase * current + (1 - phase) * before


def _within_limit(scope: Scope, joint: int, measured: Expr) -> Expr:
    """Measured current, limited to the sensor's reading at the current limit."""
    limit = current_limit(scope, joint)
    low, high = (measured_current(scope, joint, bound) for bound in (-limit, limit))
    return ca.fmin(ca.fmax(measured, low), high)


def _kept_fraction(scope: Scope, time_s: Expr) -> Expr:
    """In-phase gain of a first-order low-pass at the frequency of the steps."""
    return 1 / (1 + (2 * math.pi * time_s / declare_step_length(scope)) ** 2)
