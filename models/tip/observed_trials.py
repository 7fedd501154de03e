"""Trials with their observer, also with observers whose plant is wrong on purpose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from models.learning.predictors import Array
from models.plant.simulation.compiled_model import CompiledModel, model_inputs
from models.plant.step_model import StepModel, names
from models.tip.tip_rows import ObservedTrial
from models.trials.trial import Trial

__all__ = ["WRONG_STIFFNESS", "observe", "wrong_stiffness"]

WRONG_STIFFNESS: Final = (0.8, 1.2)
"""Factors on the stiffness of the observer's plant, for the calibration of the interval: the
largest error of a plant that is required to be noticed."""


def observe(
    compiled: CompiledModel, trials: Sequence[Trial], changes: Mapping[str, float] | None = None
) -> list[ObservedTrial]:
    """Run the observer along trials.

    Row k is the output after the step that ends at sample k, as on the robot. The geometry is the
    plant's, not the trial's.

    Parameters
    ----------
    compiled : CompiledModel
        Observer of the trials' dof.
    trials : sequence of Trial
        Recorded angles and currents.
    changes : mapping of str to float, optional
        Parameters that differ from the plant's.
    """
    model, found = compiled.model, []
    p: Array = model.parameter_values(changes)
    for trial in trials:
        y = compiled.simulate(model_inputs(model, trial), trial.step_s, p)[1:]
        signals = dict(zip(names(model.outputs), np.ascontiguousarray(y.T), strict=True))
        found.append(ObservedTrial(trial, signals))
    return found


def wrong_stiffness(model: StepModel, factor: float) -> dict[str, float]:
    """Return the values of all stiffness parameters times a factor.

    Parameters
    ----------
    model : StepModel
        Observer.
    factor : float
        On each stiffness.
    """
    return {v.name: factor * v.start for v in model.parameters if "_stiffness_" in v.name}
