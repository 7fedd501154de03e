"""Strength consistency: whether one strength of an effect fits everywhere.

An effect that stands in for another fits one signal, payload or band of frequencies at one strength
and the next at another. So the contribution of a named effect is cut into such blocks, and the
strength of each is freed by a fraction δ_b around the common fit, to first order, with nuisance and
every common strength refitted. With s the scores of δ and Λ their information,

    D² = Σ (s_i² − λ_i) / (λ_i + 1) / Σ λ_i        in the axes of Λ

is the mean square by which the strengths differ, noise and undetermined directions taken out;
Σ s_i² / (λ_i + τ² λ_i²) is χ² where they differ by no more than τ, which a simpler equation may.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.normal_equation import NormalEquation, stacked
from models.plant.identification.noise_floor import Array, TrialGroup


@dataclass(frozen=True)
class StrengthConsistency:
    """Difference of an effect's strengths between payloads, signals and bands."""

    standard_deviation: float  # D of the module's docstring, as a fraction of the strength
    probability: float  # Of a larger χ² if strengths differ by no more than is tolerated
    tolerated: float  # Fraction by which they may differ
    holds: bool  # Whether one strength fits everywhere


def strength_consistency_of(
    estimator: GaussNewton, point: FitPoint, free: Array, own: Array
) -> StrengthConsistency:
    """Consistency of the strength of one effect.

    Shapes: `free` (p,), `own` (p,).
    """
    settings = estimator.settings
    tolerated = settings.tolerated_difference_fraction
    least = settings.least_block_information
    values = point.values.copy()
    values[own] = 0.0
    without = estimator.residuals.residuals(values)
    part = [w - r for w, r in zip(without, point.rows, strict=True)]
    blocks = np.array([stacked(estimator.whiten(b)).ravel() for b in _blocks(estimator, part)])
    blocks = blocks[np.sum(blocks**2, axis=1) > least].T
    if not blocks.size:
        return StrengthConsistency(0.0, 1.0, tolerated, True)
    scores, information = _released(estimator, point, free, blocks)
    size, axes = np.linalg.eigh(information)
    size, scores = np.maximum(size, 0.0), axes.T @ scores
    square = np.sum((scores**2 - size) / (size + 1)) / max(size.sum(), 1e-12)
    seen = size > least
    size, scores = size[seen], scores[seen]
    deviation = np.sum(scores**2 / (size + tolerated**2 * size**2))
    probability = float(chi2.sf(deviation, max(len(size), 1)))
    differs = float(np.sqrt(max(square, 0.0)))
    holds = differs <= tolerated or probability >= settings.inconsistency_probability
    return StrengthConsistency(differs, probability, tolerated, holds)


def strengths_hold(
    estimator: GaussNewton, point: FitPoint, free: Array, own: Iterable[Array]
) -> bool:
    """Whether each of several effects has the same strength everywhere."""
    return all(strength_consistency_of(estimator, point, free, row).holds for row in own)


def _blocks(estimator: GaussNewton, part: Sequence[Array]) -> Iterator[list[Array]]:
    """Contribution of an effect, one payload, signal and band at a time."""
    residuals, bands = estimator.residuals, estimator.settings.consistency_bands
    for g, group in enumerate(residuals.groups):
        payload = np.array([residuals.trials[k].meta.payload_kg for k in group.trials])
        for p in np.unique(payload):
            for s in range(len(group.signals)):
                for band in _bands(group, bands):
                    block = [np.zeros_like(rows) for rows in part]
                    block[g][payload == p, s, band] = part[g][payload == p, s, band]
                    yield block


def _bands(group: TrialGroup, count: int) -> list[slice]:
    edges = np.round(np.geomspace(1, group.coefficients, count + 1)).astype(int)
    edges[0] = 0
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def _released(
    estimator: GaussNewton, point: FitPoint, free: Array, blocks: Array
) -> tuple[Array, Array]:
    """Scores and information of the blocks' strengths, with the common fit parameters refitted."""
    index = np.flatnonzero(free)
    estimator.linearise(point, free)
    slopes = np.concatenate([s[:, index] for s in point.slopes])
    residual = stacked(estimator.whitened(point.rows)).ravel()
    across = slopes.T @ blocks
    ridge = estimator.settings.normal_ridge_fraction
    refit = NormalEquation.of(point.normal, index).solve(across, ridge)
    scores = blocks.T @ residual - refit.T @ point.gradient[index]
    information = blocks.T @ blocks - across.T @ refit
    return scores, (information + information.T) / 2
