"""Residuals as spectra: a cosine transform in which a stationary error is nearly uncorrelated.

The orthonormal DCT-II of a trial of n samples has coefficients at k / (2 n h); those up to
`GapSettings.highest_frequency_hz` are kept. The variance of a coefficient is the noise's spectrum
at its frequency, which accounts for autocorrelation: a slow error fills few coefficients, so it
counts as few samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

Array = NDArray[np.float64]


def coefficient_count(samples: int, step_s: float, highest_hz: float) -> int:
    """Number of coefficients of a trial that are used."""
    return min(samples, max(4, int(2 * samples * step_s * highest_hz)))


def coefficient_frequencies_hz(coefficients: int, samples: int, step_s: float) -> Array:
    """Frequencies of the first coefficients of a trial, shape (K,)."""
    return np.arange(coefficients) / (2 * samples * step_s)


def cosine_transform(rows: Array, coefficients: int) -> Array:
    """First coefficients (K, ...) of rows (n, ...)."""
    return np.asarray(dct(rows, type=2, norm="ortho", axis=0)[:coefficients])


def inverse_cosine_transform(coefficients: Array, samples: int) -> Array:
    """Rows (n, ...) of coefficients (K, ...)."""
    return np.asarray(idct(coefficients, type=2, norm="ortho", axis=0, n=samples))


def smoothed_power(power: Array, width_fraction: float, least_coefficients: int) -> Array:
    """Mean of power over neighbouring coefficients.

    `width_fraction`: half width of the window, as a fraction of the frequency. Shapes: `power`
    (..., K).
    """
    count = power.shape[-1]
    total = np.concatenate([np.zeros((*power.shape[:-1], 1)), np.cumsum(power, axis=-1)], axis=-1)
    half = np.maximum(least_coefficients, (width_fraction * np.arange(count)).astype(int))
    low = np.maximum(np.arange(count) - half, 0)
    high = np.minimum(np.arange(count) + half + 1, count)
    return np.asarray((total[..., high] - total[..., low]) / (high - low))
