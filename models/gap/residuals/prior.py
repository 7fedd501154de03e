"""Prior of the fit parameters: how far nuisance and the variation between trials go by chance.

Each costs ½ (θ_k / s_k)², with its standard deviation s_k. A clock error common to all trials is no
variation between them: the nuisance `synchronisation` models it, up to what counts as synchronised
(`GapSettings.clock_limit_s`). So the mean over the trials costs as if it were known. Otherwise six
clocks that are 8 ms late would cost little, and would hide an offset of 18 ms.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.gap.residuals.fit_parameters import FitParameter
from models.plant.identification.noise_floor import KNOWN_FRACTION, SHARED, Array


def prior_precision(fit_parameters: Sequence[FitParameter]) -> Array:
    """Precision of each fit parameter's own prior, shape (p,); 0 without a prior."""
    deviation = np.array([q.standard_deviation for q in fit_parameters])
    return np.where(np.isfinite(deviation), 1 / deviation**2, 0.0)


def prior_matrix(fit_parameters: Sequence[FitParameter]) -> Array:
    """Precision matrix of all fit parameters together, shape (p, p)."""
    matrix = np.diag(prior_precision(fit_parameters))
    own = np.array([q.kind == "trial" and q.name == SHARED for q in fit_parameters])
    if own.any():
        deviation = np.array([q.standard_deviation for q in fit_parameters])[own]
        by_chance = np.sqrt(np.sum(deviation**2)) / len(deviation)
        mean = np.where(own, 1 / own.sum(), 0.0) / (KNOWN_FRACTION * by_chance)
        matrix += np.outer(mean, mean)
    return matrix
