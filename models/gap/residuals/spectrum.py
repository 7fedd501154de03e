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
    """Number of coefficients of a trial that are kept.

    Parameters
    ----------
    samples : int
        Of the trial.
    step_s : float
        Time step.
    highest_hz : float
        Highest frequency.

    Examples
    --------
    >>> coefficient_count(512, 0.017, 8.0), coefficient_count(3, 0.017, 8.0)
    (139, 3)
    """
    return min(samples, max(4, int(2 * samples * step_s * highest_hz)))


def coefficient_frequencies_hz(coefficients: int, samples: int, step_s: float) -> Array:
    """Frequencies of the first coefficients of a trial of so many samples, shape (K,).

    Parameters
    ----------
    coefficients : int
        Number K of coefficients.
    samples : int
        Of the trial.
    step_s : float
        Time step.
    """
    return np.arange(coefficients) / (2 * samples * step_s)


def cosine_transform(rows: Array, coefficients: int) -> Array:
    """First coefficients (K, …) of rows (n, …).

    Parameters
    ----------
    rows : ndarray, shape (n, ...)
        Samples.
    coefficients : int
        Number that is kept.

    Examples
    --------
    The transform is orthonormal: with all coefficients kept nothing is lost.

    >>> rows = np.array([1.0, -2.0, 0.5, 3.0])
    >>> kept = cosine_transform(rows, 4)
    >>> bool(np.isclose(kept @ kept, rows @ rows))
    True
    >>> bool(np.allclose(inverse_cosine_transform(kept, 4), rows))
    True
    """
    return np.asarray(dct(rows, type=2, norm="ortho", axis=0)[:coefficients])


def inverse_cosine_transform(coefficients: Array, samples: int) -> Array:
    """Rows (n, …) of coefficients (K, …).

    Parameters
    ----------
    coefficients : ndarray, shape (K, ...)
        Missing ones count as zero.
    samples : int
        Number of rows n.
    """
    return np.asarray(idct(coefficients, type=2, norm="ortho", axis=0, n=samples))


def smoothed_power(power: Array, width_fraction: float, least_coefficients: int) -> Array:
    """Mean of power over neighbouring coefficients.

    Parameters
    ----------
    power : ndarray, shape (..., K)
        Squared coefficients, averaged over trials.
    width_fraction : float
        Half width of the window, as a fraction of the frequency.
    least_coefficients : int
        Least half width.
    """
    count = power.shape[-1]
    total = np.concatenate([np.zeros((*power.shape[:-1], 1)), np.cumsum(power, axis=-1)], axis=-1)
    half = np.maximum(least_coefficients, (width_fraction * np.arange(count)).astype(int))
    low = np.maximum(np.arange(count) - half, 0)
    high = np.minimum(np.arange(count) + half + 1, count)
    return np.asarray((total[..., high] - total[..., low]) / (high - low))
