"""Limit on the rows of long trials in a fit, so that it takes minutes and little memory.

A fit simulates its trials some hundred times. The cost of a simulation, its state updates, is rows
times sub-steps times states. A trial above the limit is cut to its first rows, and so are the
longest of several trials that are above it together. The first rows begin at rest, so the state at
the start is known. Whatever is simulated once (`evaluate`, the errors before and after a diagnosis)
uses whole trials; there the rest of a cut trial is held out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from models.plant.step_model import StepModel
from models.trials.trial import Trial

__all__ = ["shortened"]

MOST_OF_TRIAL: Final = 3e6
"""Most state updates in one simulation of a trial: 20 800 rows of the link with every effect and
one joint, 430 000 rows of a mass on a guide at 1 kHz. Measured: 1.6 s of processor time for the
exact derivatives of the former; a diagnosis needs about twenty of them."""

MOST_OF_ALL: Final = 10e6
"""Most state updates in one simulation of all trials; `make demo` needs 1 % of it [assumed]."""

LEAST_ROWS: Final = 200
"""Fewest rows that a cut trial keeps [assumed]."""

REST_FRACTION: Final = 0.25
"""Largest fraction of a cut trial at rest before the motion [assumed]."""


def shortened(trials: Sequence[Trial], model: StepModel, substep_s: float) -> tuple[Trial, ...]:
    """Cut trials to the limits, for a model with internal steps of at most `substep_s`."""
    cost = np.array(
        [len(model.states) * max(1, math.ceil(t.step_s / substep_s - 1e-9)) for t in trials]
    )
    updates = np.minimum(cost * np.array([len(t) for t in trials]), MOST_OF_TRIAL)
    each = _level(updates, MOST_OF_ALL)
    return tuple(
        _first_rows(t, max(LEAST_ROWS, int(min(each, MOST_OF_TRIAL) / c)))
        for t, c in zip(trials, cost, strict=True)
    )


def _level(sizes: NDArray[np.float64], most: float) -> float:
    """Level w with sum(min(size, w)) = most; infinite if the sum of all sizes is below."""
    left = most
    for place, size in enumerate(np.sort(sizes)):
        level = left / (len(sizes) - place)
        if size > level:
            return level
        left -= float(size)
    return math.inf


def _first_rows(trial: Trial, rows: int) -> Trial:
    """First rows of a trial, with only the end of a long rest before the motion."""
    if rows >= len(trial):
        return trial
    rest = trial.meta.rest_samples
    start = max(0, rest - int(REST_FRACTION * rows))
    meta = msgspec.structs.replace(trial.meta, rest_samples=rest - start)
    columns = {name: column[start : start + rows] for name, column in trial.columns.items()}
    return replace(trial, meta=meta, columns=columns)
