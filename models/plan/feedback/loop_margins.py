"""Gain and phase margin of a loop by its frequency response; the highest gain for given margins."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Response = NDArray[np.complex128]
LEAST_GAIN_DB: Final = 6.0
LEAST_PHASE_RAD: Final = float(np.radians(45.0))
"""Margins that every loop must keep (requirement)."""


def gain_margin(loop: Response) -> float:
    """Factor by which the gain may rise until the loop is unstable; infinite if it never is.

    The loop is an integrator around a stable plant, so it is stable at small gain. It stays stable
    up to the least gain at which its response reaches −1.

    Shapes: `loop` (n,).
    """
    imag = loop.imag
    at = np.flatnonzero(imag[:-1] * imag[1:] <= 0.0)
    place = _between(loop, at, imag[:-1], imag[1:]).real
    largest = float(np.max(-place, initial=0.0))
    return np.inf if largest == 0.0 else 1.0 / largest


def phase_margin_rad(loop: Response) -> float:
    """Least distance of the phase from −180° where the gain is 1; infinite if it never is.

    Shapes: `loop` (n,).
    """
    size = np.abs(loop)
    at = np.flatnonzero((size[:-1] - 1.0) * (size[1:] - 1.0) <= 0.0)
    place = _between(loop, at, size[:-1] - 1.0, size[1:] - 1.0)
    return float(np.min(np.abs(np.angle(-place)), initial=np.inf))


def crossover_rad_s(loop: Response, rates_rad_s: Array) -> float:
    """Lowest frequency at which the gain falls below 1.

    Shapes: `loop` (n,), `rates_rad_s` (n,).
    """
    size = np.abs(loop)
    after = int(np.argmax(size < 1.0))
    if after == 0:
        return float(rates_rad_s[0])
    own = slice(after - 1, after + 1)
    return float(np.interp(-1.0, -size[own], rates_rad_s[own]))


def highest_gain(loops: list[Response], gain_db: float, phase_rad: float) -> float:
    """Highest factor on every loop with which all keep the margins; 0 if there is none."""
    by_gain = min(gain_margin(loop) for loop in loops) * 10.0 ** (-gain_db / 20.0)
    for factor in min(by_gain, 1e6) * np.geomspace(1.0, 1e-3, 120):
        if all(phase_margin_rad(factor * loop) >= phase_rad for loop in loops):
            return float(factor)
    return 0.0


def _between(loop: Response, at: NDArray[np.intp], before: Array, after: Array) -> Response:
    """Response at the zeros of a quantity, interpolated linearly within each interval."""
    change = before[at] - after[at]
    part = np.divide(before[at], change, out=np.zeros(len(at)), where=change != 0.0)
    return np.asarray(loop[at] + part * (loop[at + 1] - loop[at]))
