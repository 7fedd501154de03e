"""Samples: rows of trials with features, end effector and trial of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from models.learning.predictors import Array
from models.learning.validation import split_rows
from models.trials.trial import Trial

__all__ = ["VARIANTS", "Samples", "Source", "collect_samples"]

Source = Literal["true", "observer", "lagged", "none"]
"""Source of DI: motion capture, the plant observer, the lagged regressor, or none."""

VARIANTS: Final[dict[str, Source]] = {
    "with_di": "true",
    "without_di": "none",
    "estimated_di": "observer",
}
"""The study's three predictors, and the source of DI for the training and tests of each."""


@dataclass(frozen=True)
class Samples:
    """Moving rows of several trials (512 steps each in the paper), stacked.

    A row without any marker has no true DI. It is left out for every source, so that all
    predictors are compared on the same rows.
    """

    trials: tuple[Trial, ...]
    kept: tuple[NDArray[np.bool_], ...]  # Rows of each trial that are used
    run: NDArray[np.intp]  # (n,), index of the trial in `trials`
    time_s: Array  # (n,), time in the trial
    payload_kg: Array
    signals: Array  # (n, 2 * dof), angles and currents
    tip_m: Array  # (n, 3), end effector by motion capture
    di: dict[str, Array]  # (n,) each, DI by source

    def __len__(self) -> int:
        return len(self.run)

    def features(self, source: Source) -> Array:
        """Inputs of a predictor: angles, currents and DI.

        The source "none" leaves the column of DI out, which fits the same functions as the paper's
        DI = 0.
        """
        if source == "none":
            return self.signals
        return np.column_stack([self.signals, self.di[source]])

    def rows_of(self, arrays: Sequence[Array]) -> Array:
        """Used rows of arrays, stacked; one array per trial, with one row per row of the trial."""
        return _stack(arrays, self.kept)

    def parts(self) -> dict[str, NDArray[np.bool_]]:
        """Rows of each part of a table (see `models.learning.validation.split_rows`)."""
        phases = np.array([t.meta.phase_2_rad for t in self.trials])
        return split_rows(self.payload_kg, phases[self.run])

    @property
    def angle_rad(self) -> Array:
        """Joint angles, shape (n, dof)."""
        return self.signals[:, : self.signals.shape[1] // 2]


def collect_samples(trials: Sequence[Trial], di: Mapping[str, Sequence[Array]]) -> Samples:
    """Stack the moving rows of trials.

    `di`: by source, DI of every row of each trial, rest rows included; must contain "true".
    """
    kept = []
    for trial, true in zip(trials, di["true"], strict=True):
        keep = np.isfinite(true)
        keep[: trial.meta.rest_samples] = False
        if not keep.any():
            raise InputError(
                trial.path, "shows no marker while the link moves", "record the trial again"
            )
        kept.append(keep)
    return Samples(
        tuple(trials),
        tuple(kept),
        np.concatenate([np.full(int(keep.sum()), i) for i, keep in enumerate(kept)]),
        _stack([t.time_s for t in trials], kept),
        _stack([np.full(len(t), t.meta.payload_kg) for t in trials], kept),
        _stack([np.hstack([t.angle_rad, t.current_a]) for t in trials], kept),
        _stack([t.tip_m for t in trials], kept),
        {source: _stack(arrays, kept) for source, arrays in di.items()},
    )


def _stack(arrays: Sequence[Array], kept: Sequence[NDArray[np.bool_]]) -> Array:
    return np.concatenate([a[rows] for a, rows in zip(arrays, kept, strict=True)])
