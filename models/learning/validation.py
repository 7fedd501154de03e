"""How predictors are judged: folds that do not leak, and the mean Euclidean distance."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.learning.predictors import Array, Fold

BLOCKS: Final = 5
GAP_S: Final = 1.0
"""Rows this close to a held-out block are dropped from training: neighbours 17 ms apart are
nearly copies, so a block without a gap would be tested on its own training data."""


def block_folds(run: NDArray[np.intp], time_s: Array) -> list[Fold]:
    """Five contiguous blocks of each run, held out in turn, with 1 s gaps around them.

    Parameters
    ----------
    run : ndarray of int, shape (n,)
        Number of the trial that each row comes from.
    time_s : ndarray, shape (n,)
        Time of each row in its trial.
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
    """Each payload held out in turn: how far the predictor carries to a payload not seen."""
    return [
        (np.flatnonzero(payload_kg != kg), np.flatnonzero(payload_kg == kg))
        for kg in np.unique(payload_kg)
    ]


def euclidean_distance_m(actual_m: Array, predicted_m: Array) -> Array:
    """Distance between end effectors, row by row (paper, eq. 4 to 7), shape (n,)."""
    return np.asarray(np.linalg.norm(actual_m - predicted_m, axis=1), dtype=np.float64)


def split_rows(payload_kg: Array, phase_2_rad: Array) -> dict[str, NDArray[np.bool_]]:
    """Rows of each part that a table reports.

    Returns
    -------
    dict of str to ndarray of bool, shape (n,)
        "pooled" for all; "0", "0.5", … for one payload in kg; "phase_90deg", … for one phase of
        joint 2 where the rows hold several.
    """
    parts = {"pooled": np.ones(len(payload_kg), dtype=bool)}
    for kg in np.unique(payload_kg):
        parts[payload_key(float(kg))] = payload_kg == kg
    phases = np.unique(phase_2_rad)
    for phase in phases if len(phases) > 1 else ():
        parts[f"phase_{np.degrees(phase):.0f}deg"] = phase_2_rad == phase
    return parts


def payload_key(payload_kg: float) -> str:
    """Write a payload in kg as `study.json` does: "0", "0.5", "1"."""
    return f"{payload_kg:g}"


def r_squared(actual: Array, estimate: Array) -> float:
    """Share of the variance that the estimate explains; negative where worse than the mean."""
    return float(1.0 - np.sum((actual - estimate) ** 2) / np.sum((actual - actual.mean()) ** 2))
