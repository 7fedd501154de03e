"""Validation of predictors: folds without leakage, distances, R²."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.learning.predictors import Array, Fold

__all__ = [
    "block_folds",
    "euclidean_distance_m",
    "payload_folds",
    "payload_key",
    "r_squared",
    "split_rows",
]

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
