"""What to feed a unit with: a reference motion, or the rows of a trial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.motion import Motion
from firmware_py.signals import DI, PAYLOAD, PERIOD_S, feature_names
from fmu.fmu_models import Parts
from models.plant.simulation.compiled_model import CompiledModel
from models.plant.simulation.compiled_model import trial_inputs as inputs_from
from models.plant.step_model import StepModel, names
from models.trials.deformation import deformation_index
from models.trials.trial import Trial

Array = NDArray[np.float64]


def motion_inputs(
    parts: Parts, model: StepModel, motion: Motion, payload_kg: float, step_s: float = PERIOD_S
) -> Array:
    """Inputs of a unit for a motion.

    A twin gets the goals. An observer gets the angles and currents of the twin of its own plant. A
    predictor gets the goals as angles, and currents and a DI that sweep through typical values.

    Returns
    -------
    ndarray, shape (n, inputs)
        Row k drives step k.
    """
    goal_rad = motion.table_rad(step_s)
    if parts.kind == "predictor":
        return _sweep(goal_rad)
    columns = {f"goal_{j + 1}_rad": goal_rad[:, j] for j in range(parts.dof)}
    columns[PAYLOAD.name] = np.full(len(goal_rad), payload_kg)
    if parts.kind == "twin":
        return _columns(model, columns)
    assert parts.plant is not None
    twin = CompiledModel(parts.plant.step_model(parts.dof, "twin"))
    y = twin.simulate(_columns(twin.model, columns), step_s)[1:]
    return _columns(model, dict(zip(names(twin.model.outputs), y.T, strict=True)))


def trial_inputs(parts: Parts, model: StepModel, trial: Trial) -> Array:
    """Inputs of a unit from a trial's columns, its payload and, for a predictor, its true DI.

    Raises
    ------
    InputError
        If the trial has another number of joints.
    """
    if trial.meta.dof != parts.dof:
        raise InputError(
            trial.path, f"is of {trial.meta.dof}DOF, the unit of {parts.dof}DOF",
            "choose a trial of the unit's own dof",
        )  # fmt: skip
    if parts.kind == "predictor":
        trial = replace(trial, columns={**trial.columns, DI.name: deformation_index(trial)})
    return inputs_from(model, trial)


def _columns(model: StepModel, columns: Mapping[str, Array]) -> Array:
    return np.column_stack([columns[name] for name in names(model.inputs)])


def _sweep(angle_rad: Array) -> Array:
    """Features of the predictor: angles as given, currents to 3 A and DI to 1 % out of phase."""
    count, dof = angle_rad.shape
    turn = 2.0 * np.pi * np.arange(count) / count
    current_a = [3.0 * np.sin((j + 3) * turn) for j in range(dof)]
    di = 0.005 * (1.0 - np.cos(5.0 * turn))
    sweep = np.column_stack([angle_rad, *current_a, di])
    assert sweep.shape[1] == len(feature_names(dof))
    return sweep
