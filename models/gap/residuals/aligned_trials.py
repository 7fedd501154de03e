"""Trials of one motion, cut so that equal rows are equal times of the motion.

Common errors and scatter of the trials of a motion are averaged row by row. A recording that was
started by hand has its own rest before the motion, and its own end.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Final

import msgspec

from models.gap.residuals.residuals import trial_group_key
from models.trials.trial import Trial, TrialSet, motion_start

MOST_CUT: Final = 0.1
"""Largest part of a motion that is cut off to match a shorter trial of it [assumed]."""


def aligned(trials: TrialSet) -> TrialSet:
    """Trials whose rest is that of their goals; those of one motion get equal rests and ends.

    Trials are not cut to match one that is shorter by more than `MOST_CUT`.
    """
    starts = [motion_start(t) for t in trials]
    motions: dict[str, list[int]] = defaultdict(list)
    for k, trial in enumerate(trials):
        motions[trial_group_key(_rows(trial, 0, slice(2)))].append(k)  # whatever its length
    result = list(trials)
    for own in motions.values():
        rest, common = min(starts[k] for k in own), 0
        moving = {k: len(result[k]) - starts[k] for k in own}
        for k in sorted(own, key=moving.__getitem__):
            if moving[k] * (1 - MOST_CUT) > common:
                common = moving[k]
            first = starts[k] - rest
            result[k] = _rows(result[k], rest, slice(first, first + rest + common))
    return TrialSet(tuple(result))


def _rows(trial: Trial, rest: int, kept: slice) -> Trial:
    """Rows `kept` of a trial, with `rest` rows before the start of its motion."""
    meta = msgspec.structs.replace(trial.meta, rest_samples=rest)
    columns = {name: column[kept] for name, column in trial.columns.items()}
    return replace(trial, meta=meta, columns=columns)
