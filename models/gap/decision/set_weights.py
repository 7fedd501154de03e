"""Weights of sets of effects that explain the same trials.

The weight of a set is exp(score / 2T): its score is the fall of twice the cost, less what its
effects reach where nothing is missing (`models.gap.search.null_distribution`). The temperature T
keeps the errors of the equations in: an equation that misses a fraction of the gap shifts the score
of every set by a fraction of the gap's own, so T grows with the best score.

Before the trials the number of missing effects is Poisson distributed with mean one, and every set
of one number is equally likely: in a large catalogue of N effects each effect of a set then counts
1/N. Without such a prior the many sets that add a useless effect to the right one outweigh it.

The two temperatures were fitted to 32 data sets of ten rigs of drawn structure (`drawn_24` to
`drawn_33`) by their logarithmic score; on 37 others the growth of 1/30 and 1/15 gave 1.19 and 1.23,
any least temperature the same.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from models.gap.residuals.spectrum import Array

LEAST_TEMPERATURE: Final = 1.5
"""Temperature without a gap: a difference of d′ = 3 counts 20 to 1
(`GapSettings.indistinguishable_separation`)."""

TEMPERATURE_OF_GAP: Final = 1 / 15
"""Growth of the temperature with the square of d′. Of 1/60, 1/30, 1/20, 1/15, 1/10 and 1/7 those
from 1/15 on gave one Brier score; with less, an effect that corrects the first one's equation
counted as missing in 4 of 32 data sets."""


def set_weights(size: Array, score: Array, catalogue: int) -> Array:
    """Weight of each of some sets that are not empty, relative to the heaviest, shape (n,).

    Parameters
    ----------
    size : ndarray of int, shape (n,)
        Effects in each set.
    score : ndarray, shape (n,)
        Fall of twice the cost, less what it must reach.
    catalogue : int
        Effects that could be missing.
    """
    temperature = LEAST_TEMPERATURE + TEMPERATURE_OF_GAP * max(float(score.max()), 0.0)
    logarithm = score / (2 * temperature) - size * np.log(max(catalogue, 1))
    return np.asarray(np.exp(logarithm - logarithm.max()))
