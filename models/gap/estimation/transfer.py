"""Transfer of the plant's own error to trials on which it was not measured.

To another trial of the same motion: the error is a curve in time that begins with the motion. For a
trial of that motion with another length, step or rest before it, the curve is transformed back to
time, aligned with the start of the motion, interpolated and transformed again. At rest it keeps its
first value. Beyond its end it repeats with the motion, if the goals do; otherwise the error of the
trial is unknown.

To another payload: the noise floor treats the error as alike at neighbouring payloads, with the
correlation exp(−|Δ payload| / reach) of `PAYLOAD_REACH_KG`. A Gaussian process with it (Rasmussen
and Williams 2006, section 2.2) gives, from the errors at the measured payloads, the expected error
at any other one and its variance: zero at a measured payload, 46 % of the prior variance in the
middle of two that are one reach apart, 63 % one half of a reach beyond the last one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np
from scipy.interpolate import CubicSpline

from firmware_py.core.signals import PERIOD_S
from models.plant.identification.trial_spectra import cosine_transform, inverse_cosine_transform
from models.plant.step_model import Array
from models.trials.trial import Trial

Knowledge = Literal["measured", "transferred", "unknown"]
"""Whether an error was measured on trials like these, transferred from others of their motion, or
is unknown."""

STUDY_REST_S: Final = 60 * PERIOD_S
"""Rest before the motion of trials whose record does not state it: the rig's
(`models.rig.protocol`)."""

_LENGTH: Final = re.compile(r" (?P<rows>\d+)x(?P<step>[\d.e+-]+)s(?=( \S+=\S+)*$)")
"""Length and step in `models.plant.identification.trial_spectra.trial_group_key`."""

GOAL_TOLERANCE: Final = 0.02
"""Fraction of the largest goal by which the goals of two periods may differ [assumed]."""


def motion_of(key: str) -> str:
    """Key of a group of trials without their length and step."""
    return _LENGTH.sub("", key)


def step_of(key: str) -> float | None:
    """Time between two rows of a group of trials in s; None if its key does not state it."""
    length = _LENGTH.search(key)
    return float(length["step"]) if length else None


def transferred(
    spectra: Array, key: str, rest_s: float | None, to: Trial, count: int
) -> Array | None:
    """Spectra for a trial of the same motion, shape (..., count); None if the motion outlasts them.

    `rest_s`: their rest before the motion; None is the rig's. Shapes: `spectra` (..., K).
    """
    length = _LENGTH.search(key)
    if length is None:
        return None
    rows, step_s = int(length["rows"]), float(length["step"])
    known_s = step_s * np.arange(rows, dtype=np.float64) - (
        STUDY_REST_S if rest_s is None else rest_s
    )
    at_s = to.step_s * (np.arange(len(to), dtype=np.float64) - to.meta.rest_samples)
    folded_s = _folded(at_s, float(known_s[-1]), to)
    if folded_s is None:
        return None
    flat = np.reshape(spectra, (-1, np.shape(spectra)[-1])).T
    curve = CubicSpline(known_s, inverse_cosine_transform(flat, rows), axis=0)
    moved = cosine_transform(curve(np.maximum(folded_s, known_s[0])), count)
    return np.asarray(moved.T.reshape(*np.shape(spectra)[:-1], len(moved)))


def _folded(at_s: Array, end_s: float, to: Trial) -> Array | None:
    """Times of a trial within a curve that ends at `end_s`, with whole periods subtracted."""
    beyond = at_s > end_s + to.step_s / 2
    period_s = to.meta.period_s
    if not beyond.any():
        return np.minimum(at_s, end_s)
    if not 0 < period_s <= end_s:
        return None
    periods = np.where(beyond, np.ceil((at_s - end_s) / period_s), 0.0)
    folded_s = np.minimum(at_s - periods * period_s, end_s)
    for name, goal in to.columns.items():
        if name.startswith("goal_"):
            before = np.interp(folded_s, at_s, goal)
            if np.max(np.abs(goal - before)) > GOAL_TOLERANCE * np.max(np.abs(goal)):
                return None
    return folded_s


PayloadCurves = Mapping[float, Mapping[str, Array]]
"""Spectra by payload in kg and signal."""


def rows_by_payload(curves: PayloadCurves, signal: str) -> tuple[list[float], list[Array]]:
    """Payloads in kg at which a signal was measured, ascending, and its spectra."""
    rows = [
        (p, by_signal[signal]) for p, by_signal in sorted(curves.items()) if signal in by_signal
    ]
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
