"""Sensitivity of a step model: exact derivatives of its run with respect to parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from models.plant.step_model import Array, StepModel, Variable, names, runge_kutta

__all__ = ["sensitivity_model"]


def sensitivity_model(
    model: StepModel, wrt: list[str], max_substep_s: float | None = None
) -> StepModel:
    """Model extended by the exact derivatives of its run with respect to some parameters.

    The states are x and S = dx/dp (column by column), the outputs y and dy/dp; S follows the
    variational equation Ṡ = f_x S + f_p, integrated by the same Runge–Kutta steps, so it is the
    derivative of the discrete run, not an approximation of one of the continuous run. Of S only the
    entries are states that can differ from zero: a parameter of a sensor moves no state.

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
    moved = _reached(model, model.rate, index)
    z = ca.MX.sym("z", nx + moved.nnz())
    u, p = ca.MX.sym("u", len(model.inputs)), ca.MX.sym("p", len(model.parameters))
    h = ca.MX.sym("h")
    x, slope = z[:nx], ca.MX(moved, z[nx:])

    def extend(function: Any, what: str, *time: Any) -> Any:
        """Result of a function, and its derivatives along the run."""
        value, by_x, by_p = _derivatives(function)(x, u, p, *time)
        along = by_x @ slope + by_p[:, index]
        dense = ca.Sparsity.dense(*along.shape)
        stacked = ca.vertcat(value, _entries(along, dense if what == "output" else moved))
        return ca.Function(f"{what}_{nw}", [z, u, p, *time], [stacked])

    started = ca.jacobian(model.initial(u, p), p)[:, index]
    initial = ca.vertcat(model.initial(u, p), _entries(started, moved))
    rate = extend(model.rate, "rate")
    return dataclasses.replace(
        model,
        name=f"{model.name}_sensitivity",
        states=model.states + _derivatives_of(model.states, wrt, moved),
        outputs=model.outputs + _derivatives_of(model.outputs, wrt),
        initial=ca.Function("initial", [u, p], [initial]),
        begin=extend(model.begin, "begin", h),
        flow=runge_kutta("flow", rate),
        finish=extend(model.finish, "finish", h),
        output=extend(model.output, "output"),
        rate=rate,
        max_substep_s=max_substep_s or model.max_substep_s,
    )


def _reached(model: StepModel, rate: Any, index: Sequence[int]) -> Any:
    """Sparsity (states, parameters) of the derivatives that can differ from zero at some time."""
    nx, shape = len(model.states), (len(model.states), len(index))
    step, found = np.zeros((nx, nx)), np.zeros(shape)
    for function in (rate, model.begin, model.finish):
        step += _pattern(function.jac_sparsity(0, 0))
        found += _pattern(function.jac_sparsity(0, 2))[:, index]
    found += _pattern(model.initial.jac_sparsity(0, 1))[:, index]
    while True:
        further = np.sign(found + step @ found)
        if np.array_equal(further, found):
            break
        found = further
    rows, columns = np.nonzero(found.T)[::-1]
    return ca.Sparsity.triplet(*shape, rows.tolist(), columns.tolist())


def _pattern(sparsity: Any) -> Array:
    return np.asarray(ca.DM(sparsity, 1), dtype=np.float64).reshape(sparsity.shape)


def _entries(matrix: Any, sparsity: Any) -> Any:
    """Entries of a matrix that a pattern holds, column by column, as a vector."""
    return ca.vec(ca.project(matrix, sparsity).nz[:])  # of a single row they are a row


def _derivatives_of(
    variables: Sequence[Variable], wrt: Sequence[str], pattern: Any = None
) -> tuple[Variable, ...]:
    """Derivatives of variables, parameter by parameter; with a pattern only those that it holds."""
    return tuple(
        dataclasses.replace(v, name=f"{v.name}_by_{w}", unit="1")
        for k, w in enumerate(wrt)
        for i, v in enumerate(variables)
        if pattern is None or pattern.has_nz(i, k)
    )


def _derivatives(function: Any) -> Any:
    """Value and sparse derivatives by the first and third argument of an SX function."""
    arguments = [ca.SX.sym(f"i{k}", function.size1_in(k)) for k in range(function.n_in())]
    value = ca.cse(function(*arguments))
    x, p = arguments[0], arguments[2]
    results = ca.cse([value, ca.jacobian(value, x), ca.jacobian(value, p)])
    return ca.Function(f"{function.name()}_derivatives", arguments, results)
