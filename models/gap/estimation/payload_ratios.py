"""Ratios of the noise floor at one payload to the floor over all payloads, by frequency.

A heavy payload brings the link near its limit: below 2 Hz two trials of one motion differ there by
ten to forty times the power of trials without payload, and the plant's own error grows alike. One
floor for all payloads would hide a small effect in the trials without payload, and would take the
scatter of the heaviest for an effect. Ratios are of power, smoothed over half the frequency to
either side. Each is pooled with one coefficient of the common floor, because repetitions are few.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from models.gap.residuals.spectrum import Array, smoothed_power

SMOOTHING_FRACTION: Final = 0.5
"""Half width of the smoothing, as a fraction of the frequency [assumed]."""

SMOOTHING_COEFFICIENTS: Final = 8
"""Least half width, in coefficients: seventeen coefficients are averaged [assumed]."""

COMMON_FRACTION: Final = 1 / (2 * SMOOTHING_COEFFICIENTS + 2)
"""Weight of the common floor beside those of a window: one coefficient."""

POINTS: Final = 12
"""Number of frequencies at which ratios are stored [assumed]."""

RatioTable = Mapping[float, Mapping[str, Array]]
"""Ratios of power, shape (POINTS,), by payload in kg and signal."""


@dataclass(frozen=True)
class PayloadRatios:
    """Ratios of power by payload and signal."""

    frequency_hz: Array  # (POINTS,)
    noise: RatioTable = field(default_factory=dict)  # Of the scatter between repetitions
    model: RatioTable = field(default_factory=dict)  # Of the plant's own error

    def noise_at(self, signal: str, payload_kg: float, hz: Array) -> Array:
        """Ratio of the noise at a payload, shape (K,); ones if none is known."""
        return self._at(self.noise, signal, payload_kg, hz)

    def model_at(self, signal: str, payload_kg: float, hz: Array) -> Array:
        """Ratio of the plant's own error at a payload, shape (K,); ones if none is known."""
        return self._at(self.model, signal, payload_kg, hz)

    def _at(self, table: RatioTable, signal: str, payload_kg: float, hz: Array) -> Array:
        """Logarithm interpolated in payload and frequency; constant beyond the ends."""
        known = sorted(p for p, own in table.items() if signal in own)
        if not known:
            return np.ones(len(hz))
        rows = np.log(np.array([table[p][signal] for p in known]))
        own = np.array([np.interp(payload_kg, known, column) for column in rows.T])
        return np.asarray(np.exp(np.interp(hz, self.frequency_hz, own)))


NO_RATIOS: Final = PayloadRatios(np.zeros(1))


def payload_ratios(
    hz: Array, signals: Sequence[str], parts: Mapping[float, Array]
) -> PayloadRatios:
    """Ratios from residuals of repeated trials; none if a payload or a repetition is alone.

    Shapes: `hz` (K,), each of `parts` (repetitions, signals, K).
    """
    if len(parts) < 2 or any(len(rows) < 2 for rows in parts.values()):
        return NO_RATIOS
    within = {p: smooth_variance(rows) for p, rows in parts.items()}
    standing = {p: _smooth(np.mean(rows, axis=0) ** 2) for p, rows in parts.items()}
    at = ratio_frequencies_hz(hz)
    return PayloadRatios(at, _ratios(within, hz, at, signals), _ratios(standing, hz, at, signals))


def ratio_frequencies_hz(hz: Array) -> Array:
    """Frequencies at which ratios are stored, shape (POINTS,)."""
    return np.geomspace(hz[1], hz[-1], POINTS)


def smooth_variance(repetitions: Array) -> Array:
    """Variance between repetitions of a trial, smoothed over frequency.

    Shapes: `repetitions` (R, signals, K).
    """
    return _smooth(np.var(repetitions, axis=0, ddof=1))


def _smooth(power: Array) -> Array:
    return smoothed_power(power, SMOOTHING_FRACTION, SMOOTHING_COEFFICIENTS)


def _ratios(
    smooth: Mapping[float, Array], hz: Array, at: Array, signals: Sequence[str]
) -> dict[float, dict[str, Array]]:
    common = np.maximum(np.mean(list(smooth.values()), axis=0), np.finfo(float).tiny)
    result: dict[float, dict[str, Array]] = {}
    for p, rows in smooth.items():
        ratio = (1 - COMMON_FRACTION) * rows / common + COMMON_FRACTION
        result[p] = {s: np.interp(at, hz, row) for s, row in zip(signals, ratio, strict=True)}
    return result
