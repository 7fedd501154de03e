"""Runs of the plant observer on recorded trials, with the equations of the observer FMU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.learning.predictors import Array
from models.plant.simulation.compiled_model import CompiledModel, model_inputs
from models.plant.step_model import names
from models.trials.trial import Trial


class ObserverRun(NamedTuple):
    """Output of the observer after each sample of a trial."""

    di: Array  # (n,)
    tip_m: Array  # (n, 3), end effector by the plant alone: a baseline without a polynomial
    payload_kg: Array  # (n,)


def run_observer(observer: CompiledModel, trial: Trial) -> ObserverRun:
    """Drive the observer with a trial's angles and currents, from its first row on.

    Row k is the output after the step that ends at sample k, as on the robot. The rest rows are
    part of the run. The geometry is the plant's, not the trial's.
    """
    y = observer.simulate(model_inputs(observer.model, trial), trial.step_s)[1:]
    rows = dict(zip(names(observer.model.outputs), y.T, strict=True))
    tip_m = np.column_stack([rows[f"tip_{axis}_m"] for axis in "xyz"])
    return ObserverRun(rows["di"], tip_m, rows["payload_kg"])
