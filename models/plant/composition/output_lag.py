"""Low-pass of measured outputs: filter states after the outputs of a composed plant.

A first-order stage of time θ delays a slow signal by θ. A stage of time zero would be infinitely
fast. So its state follows with D = √(θ² + D_0²), and the output contains the fraction θ/D of it::

    ż = (y − z) / D,   y_lagged = y + θ/D (z − y)

The mean delay is θ exactly, at zero the signal is unchanged, and all is smooth in θ. For θ well
above D_0 it is the first-order low-pass 1 / (1 + θ s) [Oppenheim & Willsky 1997]. It acts on the
current within the step; the current is sampled after it (`models.plant.composition.sample_phase`).
"""

from __future__ import annotations

from typing import Final

import casadi as ca

from models.plant.composition.step_functions import current_variable
from models.plant.scope import Expr, Scope, substitute
from models.plant.step_model import Variable

SHORTEST_LAG_S: Final = 2e-3
"""D_0: a pole at 500 per second, which an internal step of 2.9 ms integrates stably."""

LAGGED: Final = ("current_{j}_", "deflection_{j}_", "angle_{j}_", "position_{j}_",
    "torque_{j}_", "force_{j}_",
)  # fmt: skip
"""Start of the names of outputs that a joint's lag may act on; it acts on the first of them that
the plant's document declares."""


def lag_outputs(
    scope: Scope, outputs: dict[str, tuple[Variable, Expr]]
) -> dict[str, tuple[Variable, Expr]]:
    """Outputs with the low-pass of every joint applied to its signal."""
    result = dict(outputs)
    for j, lag in scope.sensor_lag.items():
        name = lagged_output(outputs, j, scope.columns)
        variable, value = outputs[name]
        if lag.jump_fraction is not None and name == current_variable(j).name:
            jump = lag.jump_fraction * scope.current_jump_per_rate[j] * scope.rate[j]
            value += _passed_fraction(lag.time_s) * jump
        second = lag.second_share
        shares = [1] if second is None else [1 - second, second]
        for number, share in enumerate(shares, 1):
            filtered = Variable(f"lagged_{name}_{number}", variable.unit)
            value = _stage(scope, filtered, value, share * lag.time_s)
        result[name] = (variable, value)
    return result


def lagged_output(
    outputs: dict[str, tuple[Variable, Expr]], joint: int, columns: tuple[str, ...] = ()
) -> str:
    """Name of the output that a joint's lag acts on (`LAGGED`).

    `columns` are those that the plant declares. An output that is not declared is not measured,
    like the current in a log without it; the lag then acts on the first declared output.
    """
    measured = [name for name in outputs if name in columns] or list(outputs)
    beginnings = [pattern.format(j=joint) for pattern in LAGGED]
    return next(name for start in beginnings for name in measured if name.startswith(start))


def _stage(scope: Scope, variable: Variable, value: Expr, time_s: Expr) -> Expr:
    still = [(s.symbol, s.initial) for s in scope.states.values()]
    state = scope.state(variable, substitute(value, still))
    scope.states[variable.name].rate = (value - state) / _delay_s(time_s)
    return value + _passed_fraction(time_s) * (state - value)


def _delay_s(time_s: Expr) -> Expr:
    return ca.sqrt(time_s**2 + SHORTEST_LAG_S**2)


def _passed_fraction(time_s: Expr) -> Expr:
    """Fraction θ/D of an output that passes through a filter of time θ."""
    return time_s / _delay_s(time_s)
