"""Sampled model as CasADi functions: the form in which every other part runs a plant.

Study, identification, FMUs and the emulated servo use a `StepModel` and do not depend on the
physics behind it. One step of length h from t to t + h is::

    x = begin(x, u, p, h)            # take the input samples (u holds over the step)
    for each of n = ceil(h / max_substep_s) sub-steps of dt = h / n:
        x = flow(x, u, p, dt)        # one integration step
    x = finish(x, u, p, h)           # discrete updates at the end of the step
    y = output(x, u, p)

A model without discrete parts has identities for `begin` and `finish`. For a model that is driven
by measurements (the observer) u is the sample at the END of the step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Variable:
    """A scalar variable of a model."""

    name: str  # Name with its unit suffix
    unit: str  # SI unit in the spelling of FMI, "1" if none
    start: float = 0.0  # Initial or nominal value
    description: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    nominal: float = 1.0
    sampled: bool = False  # Whether an output is valid at the end of a step only


ARGUMENTS: Final = {
    "initial": "up", "begin": "xuph", "flow": "xuph", "finish": "xuph", "smooth_finish": "xuph",
    "output": "xup", "rate": "xup",
}  # fmt: skip
"""Arguments of each function of a model: state x, inputs u, parameters p, step h."""


@dataclass(frozen=True)
class StepModel:
    """Sampled model; the module's docstring defines a step."""

    name: str
    inputs: tuple[Variable, ...]  # Their order is the order of u, p, x and y
    parameters: tuple[Variable, ...]
    states: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    initial: ca.Function  # (u, p) -> x at the start
    begin: ca.Function  # (x, u, p, h) -> x
    flow: ca.Function  # (x, u, p, dt) -> x
    finish: ca.Function  # (x, u, p, h) -> x
    output: ca.Function  # (x, u, p) -> y
    max_substep_s: float = 1e-3
    rate: ca.Function | None = None  # (x, u, p) -> dx/dt, which `flow` integrates
    # Form of `finish` for differentiation, if `finish` sets negligibly small states to zero: a
    # state of zero may still depend on parameters.
    smooth_finish: ca.Function | None = None
    inputs_at_end: bool = False  # Whether the inputs of a step are measured at its end

    def parameter_values(self, changes: Mapping[str, float] | None = None) -> Array:
        """Vector p of the start values, with `changes` by name."""
        names = [v.name for v in self.parameters]
        values = np.array([v.start for v in self.parameters], dtype=np.float64)
        for name, value in (changes or {}).items():
            if name not in names:
                raise KeyError(name)
            values[names.index(name)] = value
        return values

    def with_substeps(self, longest_s: float) -> StepModel:
        """Model with sub-steps of at most `longest_s`, shorter where its fastest pole requires it.

        The classical Runge–Kutta step h is stable for real poles up to |λ| h = 2.79 (Hairer and
        Wanner, *Solving Ordinary Differential Equations II*, 1996, section IV.2). The poles are
        those at the start, with all inputs zero; the limit of 2 leaves room for poles that grow
        away from rest.
        """
        p, u = self.parameter_values(), np.zeros(len(self.inputs))
        # Sensitivities have no slope along bends of zero; it stands beside the diagonal blocks, so
        # the poles do not depend on it.
        slope = np.nan_to_num(np.asarray(_slope(self.rate)(self.initial(u, p), u, p)))
        fastest_per_s = np.abs(np.linalg.eigvals(slope)).max()
        return replace(self, max_substep_s=min(longest_s, 2.0 / fastest_per_s))

    def substeps(self, step_s: float) -> int:
        """Number of sub-steps in one step of `step_s`."""
        return max(1, math.ceil(step_s / self.max_substep_s - 1e-9))

    def advance(self, x: Array, u: Array, p: Array, step_s: float) -> Array:
        """State after one step, interpreted: the reference of every compiled form."""
        step = _whole_step(self.begin, self.flow, self.finish, self.substeps(step_s))
        return np.asarray(step(x, u, p, step_s), dtype=np.float64).ravel()

    def simulate(
        self, u: Array, step_s: float, p: Array | None = None, x: Array | None = None
    ) -> Array:
        """Outputs at the start and after each step, shape (n + 1, len(outputs)).

        `u` has shape (n, len(inputs)); row k of the result is the output at k * step_s.
        """
        p = self.parameter_values() if p is None else p
        x = np.asarray(self.initial(u[0], p)).ravel() if x is None else x
        rows = [np.asarray(self.output(x, u[0], p)).ravel()]
        for row in u:
            x = self.advance(x, row, p, step_s)
            rows.append(np.asarray(self.output(x, row, p)).ravel())
        return np.array(rows)


@lru_cache(maxsize=8)
def _slope(rate: ca.Function) -> ca.Function:
    x, u, p = (ca.SX.sym(label, rate.size_in(i)) for i, label in enumerate("xup"))
    return ca.Function("slope", [x, u, p], [ca.jacobian(rate(x, u, p), x)])


@lru_cache(maxsize=8)
def _whole_step(
    begin: ca.Function, flow: ca.Function, finish: ca.Function, count: int
) -> ca.Function:
    """One step as one function, because a call costs more than the arithmetic of a sub-step."""
    x, u, p, h = (ca.MX.sym(label, begin.size_in(i)) for i, label in enumerate("xuph"))
    state = begin(x, u, p, h)
    for _ in range(count):
        state = flow(state, u, p, h / count)
    return ca.Function("whole_step", [x, u, p, h], [finish(state, u, p, h)])


def names(variables: Sequence[Variable]) -> list[str]:
    """Names of the variables, in order."""
    return [v.name for v in variables]


def runge_kutta(name: str, rate: ca.Function) -> ca.Function:
    """One classical Runge–Kutta step (x, u, p, h) -> x of x' = rate(x, u, p)."""
    x, u, p = (ca.MX.sym(label, rate.size_in(i)) for i, label in enumerate("xup"))
    h = ca.MX.sym("h")
    k1 = rate(x, u, p)
    k2 = rate(x + h / 2 * k1, u, p)
    k3 = rate(x + h / 2 * k2, u, p)
    k4 = rate(x + h * k3, u, p)
    step = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function(name, [x, u, p, h], [step], ["x", "u", "p", "h"], ["result"])
