"""Weights of sets of effects that explain the same trials.

The score of a set is the fall of twice the cost, less the fall that its effects reach where nothing
is missing (`models.gap.search.null_distribution`). A set that scores Δ less than the best one,
whose score is S, weighs exp(−min(Δ / 2T, a √(Δ / S))). The first term is that of noise. The second
accounts for equation errors: an equation that misses a fraction ε of the gap, of size √S in noise
floors, changes the difference of two scores by up to 2 ε √(S Δ), so Δ exceeds this by √(Δ / S) / 2ε
times.

A priori the number of missing effects is Poisson distributed, and all sets of one size are equally
probable: with a mean of m and a catalogue of N effects each effect of a set counts m / N. Without
such a prior the many sets that add a useless effect to the right one outweigh it. `python -m
models.gap.training sets` tries values of a and m on diagnoses of rigs for tuning. Of the
pairs whose loss is within a standard error of the least one, that with the least a, then the
largest m, is taken: it is the least certain of the best set.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from models.plant.identification.noise_floor import Array

NOISE_TEMPERATURE: Final = 1.5
"""T: a difference of d′ = 3 counts 20 to 1 (`GapSettings.indistinguishable_separation`)."""

ODDS_OF_WHOLE_GAP: Final = 12.0
"""a: logarithm of the odds between the best set and one that explains nothing."""

MEAN_NUMBER: Final = 0.05
"""m: mean number of missing effects."""


def set_weights(
    size: Array,
    score: Array,
    catalogue: int,
    odds: float = ODDS_OF_WHOLE_GAP,
    mean: float = MEAN_NUMBER,
) -> Array:
    """Weight of each of some non-empty sets, relative to the heaviest, shape (n,).

    `score`: fall of twice the cost, less what it must reach. Shapes: `size` (n,), `score` (n,).
    """
    best = float(score.max())
    less = best - score
    by_noise = less / (2 * NOISE_TEMPERATURE)
    by_equation = odds * np.sqrt(less / max(best, 1.0))
    logarithm = size * np.log(mean / max(catalogue, 1)) - np.minimum(by_noise, by_equation)
    return np.asarray(np.exp(logarithm - logarithm.max()))
