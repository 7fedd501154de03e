"""Transfer of the plant's own error to payloads at which it was not measured.

The noise floor treats the error as alike at neighbouring payloads, with the correlation exp(−|Δ
payload| / reach) of `PAYLOAD_REACH_KG`. A Gaussian process with it (Rasmussen and
Williams 2006, section 2.2) gives, from the errors at the measured payloads, the expected error at
any other one and its variance: zero at a measured payload, 46 % of the prior variance in the middle
of two that are one reach apart, 63 % one half of a reach beyond the last one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from models.plant.identification.noise_floor import Array

PayloadCurves = Mapping[float, Mapping[str, Array]]
"""Spectra by payload in kg and signal."""


def rows_by_payload(curves: PayloadCurves, signal: str) -> tuple[list[float], list[Array]]:
    """Payloads in kg at which a signal was measured, ascending, and its spectra."""
    rows = [(p, own[signal]) for p, own in sorted(curves.items()) if signal in own]
    return [p for p, _ in rows], [row for _, row in rows]


def transfer_weights(
    at_kg: Sequence[float] | Array, measured_kg: Sequence[float] | Array, reach_kg: float
) -> Array:
    """Weights of the errors at measured payloads in the expected error at others, shape (n, P).

    Shapes: `at_kg` (n,), `measured_kg` (P,).
    """
    known = _correlation(measured_kg, measured_kg, reach_kg)
    across = _correlation(at_kg, measured_kg, reach_kg)
    return np.asarray(np.linalg.solve(known, across.T).T)


def unknown_fraction(
    at_kg: Sequence[float] | Array, measured_kg: Sequence[float] | Array, reach_kg: float
) -> Array:
    """Posterior covariance of the error, as a fraction of its prior variance, shape (n, n)."""
    prior = _correlation(at_kg, at_kg, reach_kg)
    across = _correlation(at_kg, measured_kg, reach_kg)
    return np.asarray(prior - transfer_weights(at_kg, measured_kg, reach_kg) @ across.T)


def covariance(power: Array, correlation: Array) -> Array:
    """Covariance between trials, shape (K, trials, trials).

    Shapes: `power` (trials, K), `correlation` (trials, trials).
    """
    size = np.sqrt(power).T
    return np.asarray(size[:, :, None] * size[:, None, :] * correlation)


def _correlation(
    first_kg: Sequence[float] | Array, second_kg: Sequence[float] | Array, reach_kg: float
) -> Array:
    distance = np.abs(np.subtract.outer(np.asarray(first_kg), np.asarray(second_kg)))
    return np.asarray(np.exp(-distance / reach_kg))
