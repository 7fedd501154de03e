"""Strength consistency: by how much an effect's strength differs between parts of the trials.

An effect that stands in for another, or for the error of an equation, fits one signal, payload or
band of frequencies at one strength and the next at another. So its contribution is cut into such
blocks, and the strength of each is freed by a fraction δ_b around the common fit, to first order,
with nuisance and every common strength refitted. With s the scores of δ and Λ their information,

    D² = Σ (s_i² − λ_i) / (λ_i + 1) / Σ λ_i        in the axes of Λ

is the mean square by which the strengths differ, noise and undetermined directions taken out.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import (
    RIDGE,
    FitPoint,
    GaussNewton,
    Mask,
    NormalEquation,
    stacked,
)
from models.plant.identification.trial_spectra import TrialGroup
from models.plant.step_model import Array

BANDS: Final = 3
"""Frequency bands, of equal width on a logarithmic scale [assumed]."""
LEAST_INFORMATION: Final = 1.0
"""Least information of a block that counts [assumed]."""


def strength_difference(
    estimator: GaussNewton, point: FitPoint, free: Mask, strength: Mask
) -> float:
    """D of the module's docstring, as a fraction of the strength; 0 where no block shows it.

    Shapes: `free` (p,), `strength` (p,): fit parameters of the effect.
    """
    values = np.where(strength, 0.0, point.values)
    without = estimator.residuals.residuals(values)
    part = [w - r for w, r in zip(without, point.rows, strict=True)]
    blocks = np.array([stacked(estimator.whiten(b)).ravel() for b in _blocks(estimator, part)])
    blocks = blocks[np.sum(blocks**2, axis=1) > LEAST_INFORMATION].T
    if not blocks.size:
        return 0.0
    scores, information = _released(estimator, point, free, blocks)
    size, axes = np.linalg.eigh(information)
    size, scores = np.maximum(size, 0.0), axes.T @ scores
    square = np.sum((scores**2 - size) / (size + 1)) / max(size.sum(), 1e-12)
    return float(np.sqrt(max(square, 0.0)))


def _blocks(estimator: GaussNewton, part: Sequence[Array]) -> Iterator[list[Array]]:
    """Contribution of an effect, one payload, signal and band at a time."""
    residuals = estimator.residuals
    for g, group in enumerate(residuals.groups):
        payload = np.array([residuals.trials[k].meta.payload_kg for k in group.trials])
        for p, s, band in itertools.product(
            np.unique(payload), range(len(group.signals)), _bands(group)
        ):
            block = [np.zeros_like(rows) for rows in part]
            block[g][payload == p, s, band] = part[g][payload == p, s, band]
            yield block


def _bands(group: TrialGroup) -> list[slice]:
    edges = np.round(np.geomspace(1, group.coefficients, BANDS + 1)).astype(int)
    edges[0] = 0
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def _released(
    estimator: GaussNewton, point: FitPoint, free: Mask, blocks: Array
) -> tuple[Array, Array]:
    """Scores and information of the blocks' strengths, with the common fit parameters refitted."""
    index = np.flatnonzero(free)
    estimator.linearise(point, free)
    slopes = np.concatenate([s[:, index] for s in point.slopes])
    residual = stacked(estimator.whitened(point.rows)).ravel()
    across = slopes.T @ blocks
    refit = NormalEquation.of(point.normal, index).solve(across, RIDGE)
    scores = blocks.T @ residual - refit.T @ point.gradient[index]
    information = blocks.T @ blocks - across.T @ refit
    return scores, (information + information.T) / 2
