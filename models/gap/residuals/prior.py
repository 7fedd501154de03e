"""Prior of the fit parameters: how far nuisance and the variation between trials go by chance.

Each costs ½ (θ_k / s_k)², with its standard deviation s_k. A clock error common to all trials is no
variation between them: the nuisance `synchronisation` models it, up to what counts as synchronised
(`GapSettings.clock_limit_s`). So the mean over the trials costs as if it were known. Otherwise six
clocks that are 8 ms late would cost little, and would hide an offset of 18 ms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.gap.residuals.fit_parameters import FitParameter
from models.gap.residuals.spectrum import Array

SHARED_AS_NUISANCE: Final = ("sync_s",)
"""Kinds of trial variation whose common part is a nuisance within bounds."""

KNOWN_FRACTION: Final = 0.01
"""Standard deviation of a mean that counts as known, over its standard deviation by chance
[assumed]: small enough to hold the mean, large enough to keep matrices regular."""


def prior_precision(fit_parameters: Sequence[FitParameter]) -> Array:
    """Precision of each fit parameter's own prior, shape (p,); 0 without a prior."""
    deviation = np.array([q.standard_deviation for q in fit_parameters])
    return np.where(np.isfinite(deviation), 1 / deviation**2, 0.0)


def prior_matrix(fit_parameters: Sequence[FitParameter]) -> Array:
    """Precision matrix of all fit parameters together, shape (p, p)."""
    matrix = np.diag(prior_precision(fit_parameters))
    for kind in SHARED_AS_NUISANCE:
        own = np.array([q.kind == "trial" and q.name == kind for q in fit_parameters])
        if own.any():
            deviation = np.array([q.standard_deviation for q in fit_parameters])[own]
            by_chance = np.sqrt(np.sum(deviation**2)) / len(deviation)
            mean = np.where(own, 1 / own.sum(), 0.0) / (KNOWN_FRACTION * by_chance)
            matrix += np.outer(mean, mean)
    return matrix
