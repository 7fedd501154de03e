"""Residuals as spectra: a cosine transform in which a stationary error is nearly uncorrelated.

The orthonormal DCT-II of a trial of n samples has coefficients at k / (2 n h); those up to
`LIMIT_HZ` are kept, well above the first mode (1.4 to 3.5 Hz; docs/sources.md, "The link"). The
variance of a coefficient is the noise's spectrum at its frequency, which takes care of
autocorrelation: a slow error fills few coefficients, so it counts as few samples.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

Array = NDArray[np.float64]

LIMIT_HZ: Final = 8.0
"""Highest frequency that is looked at."""


def coefficient_count(samples: int, step_s: float) -> int:
    """Number of coefficients of a trial that are looked at."""
    return max(4, min(samples, int(2 * samples * step_s * LIMIT_HZ)))


def coefficient_frequencies_hz(samples: int, step_s: float) -> Array:
    """Frequency of each coefficient that is kept, shape (K,)."""
    return np.arange(coefficient_count(samples, step_s)) / (2 * samples * step_s)


def cosine_transform(rows: Array, step_s: float) -> Array:
    """Coefficients (K, …) of rows (n, …)."""
    return np.asarray(
        dct(rows, type=2, norm="ortho", axis=0)[: coefficient_count(len(rows), step_s)]
    )


def inverse_cosine_transform(coefficients: Array, samples: int) -> Array:
    """Rows (n, …) of coefficients (K, …)."""
    return np.asarray(idct(coefficients, type=2, norm="ortho", axis=0, n=samples))


def smoothed_power(power: Array, width: float = 0.25, least: int = 4) -> Array:
    """Mean of power over neighbouring coefficients, within a share `width` of the frequency.

    Parameters
    ----------
    power : ndarray, shape (..., K)
        Squared coefficients, averaged over trials.
    """
    count = power.shape[-1]
    total = np.concatenate([np.zeros((*power.shape[:-1], 1)), np.cumsum(power, axis=-1)], axis=-1)
    half = np.maximum(least, (width * np.arange(count)).astype(int))
    low = np.maximum(np.arange(count) - half, 0)
    high = np.minimum(np.arange(count) + half + 1, count)
    return np.asarray((total[..., high] - total[..., low]) / (high - low))
