"""Gain and phase margin of a loop by its frequency response; the highest gain for given margins."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Response = NDArray[np.complex128]
LEAST_GAIN_DB: Final = 6.0
LEAST_PHASE_RAD: Final = float(np.radians(45.0))
"""Margins that every loop has to keep (requirement)."""


def gain_margin(loop: Response) -> float:
    """Factor by which the gain may rise until the loop is unstable; infinite for any.

    The loop is an integrator around a stable plant: it is stable at small gain, and the least gain
    at which its response meets −1 ends that.

    Parameters
    ----------
    loop : ndarray of complex, shape (n,)
        Response at rising frequencies.
    """
    crossing = _crosses_negative_axis(loop)
    largest = float(np.max(np.abs(loop[:-1][crossing]), initial=0.0))
    return np.inf if largest == 0.0 else 1.0 / largest


def phase_margin_rad(loop: Response) -> float:
    """Least distance of the phase from −180° where the gain is 1; infinite where it never is.

    Parameters
    ----------
    loop : ndarray of complex, shape (n,)
        Response at rising frequencies.
    """
    size = np.abs(loop)
    at = np.flatnonzero((size[:-1] - 1.0) * (size[1:] - 1.0) <= 0.0)
    distance = np.minimum(np.abs(np.angle(-loop[at])), np.abs(np.angle(-loop[at + 1])))
    return float(np.min(distance, initial=np.inf))


def crossover_rad_s(loop: Response, rates_rad_s: Array) -> float:
    """Lowest frequency at which the gain falls below 1.

    Parameters
    ----------
    loop : ndarray of complex, shape (n,)
        Response.
    rates_rad_s : ndarray, shape (n,)
        Its frequencies, rising.
    """
    return float(rates_rad_s[int(np.argmax(np.abs(loop) < 1.0))])


def highest_gain(loops: list[Response], gain_db: float, phase_rad: float) -> float:
    """Highest factor on every loop with which all keep the margins; 0 for none.

    Parameters
    ----------
    loops : list of ndarray of complex
        Responses.
    gain_db, phase_rad : float
        Least margins.
    """
    by_gain = min(gain_margin(loop) for loop in loops) * 10.0 ** (-gain_db / 20.0)
    for factor in min(by_gain, 1e6) * np.geomspace(1.0, 1e-3, 120):
        if all(phase_margin_rad(factor * loop) >= phase_rad for loop in loops):
            return float(factor)
    return 0.0


def _crosses_negative_axis(loop: Response) -> NDArray[np.bool_]:
    imag = loop.imag
    return np.asarray((imag[:-1] * imag[1:] <= 0.0) & (loop.real[:-1] < 0.0))
