"""Sensitivity of a step model: exact derivatives of its run with respect to parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import casadi as ca

from models.plant.step_model import StepModel, Variable, names, runge_kutta

__all__ = ["sensitivity_model"]


def sensitivity_model(
    model: StepModel, wrt: list[str], max_substep_s: float | None = None
) -> StepModel:
    """Model extended by the exact derivatives of its run with respect to some parameters.

    The states are x and S = dx/dp (column by column), the outputs y and dy/dp; S follows the
    variational equation Ṡ = f_x S + f_p, integrated by the same Runge–Kutta steps, so it is the
    derivative of the discrete run, not an approximation of one of the continuous run.

    Parameters
    ----------
    model : StepModel
        With its `rate`.
    wrt : list of str
        Names of parameters.
    max_substep_s : float, optional
        Other longest sub-step, for a model that is not stiff.

    Raises
    ------
    ValueError
        If the model has no `rate`.
    """
    if model.rate is None:
        raise ValueError(f"{model.name} has no rate")
    index = [names(model.parameters).index(name) for name in wrt]
    nx, nw = len(model.states), len(wrt)
    z = ca.MX.sym("z", nx * (1 + nw))
    u, p = ca.MX.sym("u", len(model.inputs)), ca.MX.sym("p", len(model.parameters))
    h = ca.MX.sym("h")
    x, slope = z[:nx], ca.reshape(z[nx:], nx, nw)

    def extend(function: Any, what: str, *time: Any) -> Any:
        """Result of a function, and its derivatives along the run."""
        value, by_x, by_p = _derivatives(function)(x, u, p, *time)
        along = by_x @ slope + by_p[:, index]
        stacked = ca.vertcat(value, ca.vec(ca.densify(along)))
        return ca.Function(f"{what}_{nw}", [z, u, p, *time], [stacked])

    started = ca.jacobian(model.initial(u, p), p)[:, index]
    initial = ca.vertcat(model.initial(u, p), ca.vec(ca.densify(started)))
    rate = extend(model.rate, "rate")
    return dataclasses.replace(
        model,
        name=f"{model.name}_sensitivity",
        states=model.states + _derivatives_of(model.states, wrt),
        outputs=model.outputs + _derivatives_of(model.outputs, wrt),
        initial=ca.Function("initial", [u, p], [initial]),
        begin=extend(model.begin, "begin", h),
        flow=runge_kutta("flow", rate),
        finish=extend(model.finish, "finish", h),
        output=extend(model.output, "output"),
        rate=rate,
        max_substep_s=max_substep_s or model.max_substep_s,
    )


def _derivatives_of(variables: Sequence[Variable], wrt: Sequence[str]) -> tuple[Variable, ...]:
    """Derivatives of variables, parameter by parameter."""
    return tuple(
        dataclasses.replace(v, name=f"{v.name}_by_{w}", unit="1") for w in wrt for v in variables
    )


def _derivatives(function: Any) -> Any:
    """Value and sparse derivatives by the first and third argument of an SX function."""
    arguments = [ca.SX.sym(f"i{k}", function.size1_in(k)) for k in range(function.n_in())]
    value = ca.cse(function(*arguments))
    x, p = arguments[0], arguments[2]
    results = ca.cse([value, ca.jacobian(value, x), ca.jacobian(value, p)])
    return ca.Function(f"{function.name()}_derivatives", arguments, results)
