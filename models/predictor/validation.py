"""Validation of predictors: folds without leakage, distances, R².

Samples: rows of trials with features, end effector and trial of each.

Coverage of an interval, counted on the axes along which the tip moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import FRACTION
from firmware_py.errors import InputError
from models.predictor.polynomials import Array, Fold
from models.trials.trial import Trial

BLOCKS: Final = 5
"""Number of blocks of each run."""
GAP_S: Final = 1.0
"""Time around a held-out block whose rows are not used in training [assumed]. Rows 17 ms apart are
nearly equal, so without a gap a block would be tested on its own training data."""


def block_folds(run: NDArray[np.intp], time_s: Array) -> list[Fold]:
    """Folds of five contiguous blocks of each run, with 1 s gaps around the held-out block.

    Shapes: `run` (n,), `time_s` (n,).
    """
    runs = [np.flatnonzero(run == r) for r in np.unique(run)]
    edges = {
        int(run[rows[0]]): np.linspace(time_s[rows].min(), time_s[rows].max(), BLOCKS + 1)
        for rows in runs
    }
    folds = []
    for block in range(BLOCKS):
        start_s = np.array([edges[int(r)][block] for r in run])
        end_s = np.array([edges[int(r)][block + 1] for r in run])
        last = block == BLOCKS - 1
        test = (time_s >= start_s) & ((time_s <= end_s) if last else (time_s < end_s))
        train = (time_s <= start_s - GAP_S) | (time_s >= end_s + GAP_S)
        folds.append((np.flatnonzero(train), np.flatnonzero(test)))
    return folds


def payload_folds(payload_kg: Array) -> list[Fold]:
    """One fold per payload, which that fold holds out.

    Shapes: `payload_kg` (n,).
    """
    return [
        (np.flatnonzero(payload_kg != kg), np.flatnonzero(payload_kg == kg))
        for kg in np.unique(payload_kg)
    ]


def euclidean_distance_m(actual_m: Array, predicted_m: Array) -> Array:
    """Distance between end effectors in m, row by row (paper, eq. 4 to 7), shape (n,).

    Shapes: `actual_m`, `predicted_m` (n, 3).
    """
    return np.asarray(np.linalg.norm(actual_m - predicted_m, axis=1), dtype=np.float64)


def split_rows(payload_kg: Array, phase_2_rad: Array) -> dict[str, NDArray[np.bool_]]:
    """Rows of each part of a table, shape (n,) each.

    The parts are "pooled" for all rows; "0", "0.5", … for one payload in kg; "phase_90deg", … for
    one phase of joint 2 if the rows have several.

    Shapes: `payload_kg`, `phase_2_rad` (n,).
    """
    parts = {"pooled": np.ones(len(payload_kg), dtype=bool)}
    for kg in np.unique(payload_kg):
        parts[payload_key(float(kg))] = payload_kg == kg
    phases = np.unique(phase_2_rad)
    for phase in phases if len(phases) > 1 else ():
        parts[f"phase_{np.degrees(phase):.0f}deg"] = phase_2_rad == phase
    return parts


def payload_key(payload_kg: float) -> str:
    """Key of a payload in kg in `study.json`: "0", "0.5", "1"."""
    return f"{payload_kg:g}"


def r_squared(actual: Array, estimate: Array) -> float:
    """Coefficient of determination R²; negative if worse than the mean.

    Shapes: `actual`, `estimate` (n,).
    """
    return float(1.0 - np.sum((actual - estimate) ** 2) / np.sum((actual - actual.mean()) ** 2))


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
        """Rows of each part of a table (see `models.predictor.validation.split_rows`)."""
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


MOVING_AXES: Final = {1: (0, 2), 2: (0, 1, 2)}
"""World axes along which the tip moves, by number of joints. Joint 1 alone turns the link in the
plane of x and z: y is always covered, and a mean over three axes would hide a third of the misses.
"""
COVERS: Final = "interval covers in %, mean / worst axis"
"""Heading of a column of `coverage_text`."""


class AxisCoverage(NamedTuple):
    """Fraction of the rows inside an interval."""

    mean: float  # Mean over the axes that move
    least: float  # On the worst of the axes that move


def axis_coverage(inside: NDArray[np.bool_], dof: int) -> AxisCoverage:
    """Mean and least coverage over the axes that move.

    `inside`, shape (n, 3): whether each row is covered, by axis; at least one row.
    """
    by_axis = inside[:, list(MOVING_AXES[dof])].mean(axis=0)
    return AxisCoverage(float(by_axis.mean()), float(by_axis.min()))


def coverage_text(mean: float, least: float) -> str:
    """Both values in %, as in the tables."""
    return f"{FRACTION.number(mean, 1)} / {FRACTION.number(least, 1)}"
