"""Blocks of time of a single trial: contiguous parts that begin in motion, each a trial of its own.

With one trial, no payload, motion or repetition can be left out. Masking rows in a simulation of
the whole trial leaves little out: a free joint accumulates every torque error, so the rows after a
masked block reveal what happened in it. A block that begins at its own measured coordinate and rate
carries nothing over; this is multiple shooting [Bock 1983; Baake et al. 1992] with measured starts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from models.plant.plant import Plant
from models.plant.step_model import names
from models.trials.trial import Trial, TrialSet

BLOCKS: Final = 4
"""Blocks of time that are left out in turn where there is one trial: few enough that each holds
several motions of the available recordings, 5 to 6 s [assumed]."""
LEAST_ROWS: Final = 500
"""Fewest rows of a block that begins in motion; in shorter trials rows are masked [assumed]."""

BLOCK: Final = ", block "
"""Part of the motion's name of every block."""


def in_time_blocks(plant: Plant, trials: TrialSet) -> TrialSet:
    """Blocks of a single trial, if the plant can begin in motion; otherwise the trials unchanged.

    A plant can begin in motion if its drive declares a rate at the start.
    """
    if len(trials) != 1:
        return trials
    trial, count = trials[0], BLOCKS
    parameters = names(plant.step_model(trial.meta.dof, "twin").parameters)
    begins_in_motion = any(name.startswith("start_joint_rate_") for name in parameters)
    if not begins_in_motion or len(trial) < count * LEAST_ROWS:
        return trials
    edges = np.linspace(0, len(trial), count + 1).astype(int)
    return TrialSet(tuple(_block(trial, k, edges) for k in range(count)))


def is_time_block(trial: Trial) -> bool:
    return BLOCK in trial.meta.motion


def _block(trial: Trial, number: int, edges: NDArray[np.intp]) -> Trial:
    first, end = edges[number], edges[number + 1]
    words = f"{BLOCK}{number + 1} of {len(edges) - 1}"
    meta = msgspec.structs.replace(
        trial.meta,
        motion=trial.meta.motion + words,
        rest_samples=min(trial.meta.rest_samples, int(end) - 1) if number == 0 else 0,
    )
    columns = {name: column[first:end] for name, column in trial.columns.items()}
    return replace(trial, name=trial.name + words, meta=meta, columns=columns)
