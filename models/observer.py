"""The plant observer over recorded trials: the same equations that the robot runs as a unit."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from models.plant.step import StepModel, names
from models.predictors import Array
from models.trial import Trial


class Observation(NamedTuple):
    """What the observer answers after each sample of a trial.

    Attributes
    ----------
    di : ndarray, shape (n,)
        Estimated Deformation Index.
    tip_m : ndarray, shape (n, 3)
        End effector by the plant alone: a baseline that needs no polynomial.
    payload_kg : ndarray, shape (n,)
        Estimated payload.
    """

    di: Array
    tip_m: Array
    payload_kg: Array


def observe(model: StepModel, trial: Trial) -> Observation:
    """Drive the observer with a trial's angles and currents, from its first row on.

    Row k is the output after the step that ends at sample k, as on the robot; the rest rows are
    part of the run.
    """
    available = trial.columns
    u = np.column_stack([available[name] for name in names(model.inputs)])
    p = model.parameter_values()
    x = np.asarray(model.initial(u[0], p), dtype=np.float64).ravel()
    run = _step(model, trial.step_s).mapaccum("run", len(u))
    _, y = run(x, u.T, ca.repmat(ca.DM(p), 1, len(u)))
    rows = dict(zip(names(model.outputs), np.asarray(y, dtype=np.float64), strict=True))
    tip_m = np.column_stack([rows[f"tip_{axis}_m"] for axis in "xyz"])
    return Observation(rows["di"], tip_m, rows["payload_kg"])


def _step(model: StepModel, step_s: float) -> ca.Function:
    """One step (x, u, p) -> (x, y) of a fixed length, for CasADi to repeat without Python."""
    x = ca.MX.sym("x", len(model.states))
    u = ca.MX.sym("u", len(model.inputs))
    p = ca.MX.sym("p", len(model.parameters))
    count = model.substeps(step_s)
    state = model.begin(x, u, p, step_s)
    for _ in range(count):
        state = model.flow(state, u, p, step_s / count)
    state = model.finish(state, u, p, step_s)
    return ca.Function("step", [x, u, p], [state, model.output(state, u, p)])
