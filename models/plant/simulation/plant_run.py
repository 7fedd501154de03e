"""Simulation of a plant from arrays of inputs to arrays of signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from firmware_py.errors import InputError
from firmware_py.signals import PERIOD_S
from models.plant.plant import Plant
from models.plant.simulation.compiled_model import Array, CompiledModel
from models.plant.step_model import names

__all__ = ["simulate_plant"]


def simulate_plant(
    plant: Plant, inputs: Mapping[str, ArrayLike], step_s: float = PERIOD_S, dof: int = 1
) -> dict[str, Array]:
    """Simulate the twin of a plant from rest.

    Parameters
    ----------
    plant : Plant
        Plant to simulate.
    inputs : mapping of str to array_like, shape (n,) or ()
        Inputs of the twin by name, in SI units; a single number is constant. Row k acts from
        `k * step_s` on. By default `payload_kg` is 0 and `enabled_j` is 1.
    step_s : float
        Time between two rows in s.
    dof : int
        Number of joints, 1 or 2.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Time, inputs and outputs by name; row k at `k * step_s`.

    Raises
    ------
    InputError
        If an input is missing, unknown or of another length, or the simulation does not stay
        finite.

    Examples
    --------
    >>> from firmware_py.motion import Motion
    >>> from models.plant.plant import read_plant
    >>> goal_rad = Motion(period_s=2.0).table_rad()[:, 0]
    >>> run = simulate_plant(read_plant(), {"goal_1_rad": goal_rad, "payload_kg": 1.0})
    >>> list(run)[:4], len(run["tip_x_m"]) == len(goal_rad)
    (['time_s', 'goal_1_rad', 'payload_kg', 'angle_1_rad'], True)
    """
    model = plant.step_model(dof, "twin")
    given = _rows(names(model.inputs), inputs, dof)
    u = np.column_stack([*given.values()])
    y = CompiledModel(model).simulate(u[:-1], step_s)
    if not np.isfinite(y).all():
        raise InputError(
            f"plant {plant.name!r}", "does not stay finite", "give inputs that it can follow"
        )
    time_s: Array = step_s * np.arange(len(u), dtype=np.float64)
    outputs = {name: np.ascontiguousarray(y[:, k]) for k, name in enumerate(names(model.outputs))}
    return {"time_s": time_s, **given, **outputs}


def _rows(wanted: Sequence[str], inputs: Mapping[str, ArrayLike], dof: int) -> dict[str, Array]:
    """Inputs in the order of the model, all of one length."""
    usual = {"payload_kg": 0.0} | {f"enabled_{j}": 1.0 for j in range(1, dof + 1)}
    inputs = {name: value for name, value in usual.items() if name in wanted} | dict(inputs)
    for name in sorted({*wanted} ^ inputs.keys()):
        raise InputError(
            name, "is missing" if name in wanted else "is no input of this plant",
            "give " + ", ".join(wanted),
        )  # fmt: skip
    given = {name: np.asarray(inputs[name], dtype=np.float64) for name in wanted}
    count = max((len(a) for a in given.values() if a.ndim == 1), default=0)
    for name, array in given.items():
        if array.shape not in ((), (count,)) or count < 2:
            raise InputError(
                name, f"has the shape {array.shape}", "give two rows or more, all of one length"
            )
    return {name: np.broadcast_to(array, count).copy() for name, array in given.items()}
