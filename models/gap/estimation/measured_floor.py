"""Noise floor of the diagnosed trials: from their residual, or enlarged by their scatter.

Repeated trials with a gap contain information on noise too: near its limit no two trials of a link
are alike, and a difference between repetitions is no missing effect. With two joints and 2 kg
repetitions differed by up to 350 times the power that those of the identification had shown.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.residuals.residuals import Residuals
from models.plant.identification.noise_floor import (
    Array,
    PayloadRatios,
    TrialGroup,
    averaged,
    floor_from_residuals,
    group_frequencies_hz,
    ratio_frequencies_hz,
    smooth_variance,
)
from models.trials.trial import Trial

SLOW_HZ: Final = 2.0
"""Frequency below which a heavy payload makes two trials differ
(`models.plant.identification.noise_floor`)."""


def floor_of_residual(
    groups: Sequence[TrialGroup], trials: Sequence[Trial], rows: Sequence[Array]
) -> NoiseFloor:
    """Floor that equals the smoothed spectrum of a residual."""
    measured = floor_from_residuals(groups, trials, rows, repeated=False)
    return NoiseFloor.of(measured, learned=False)


def with_repeated_trials(
    floor: NoiseFloor, residuals: Residuals, rows: Sequence[Array]
) -> NoiseFloor:
    """Floor whose noise at each payload is pooled with that of the diagnosed repetitions.

    Floor and repetitions are two estimates of one variance; they are averaged with their degrees of
    freedom. A floor that the plant file did not carry was measured on these trials, so it is kept.

    Shapes: `rows` (trials, signals, K).
    """
    if not floor.learned:
        return floor
    known, groups, trials = floor.ratios, residuals.groups, residuals.trials
    at = ratio_frequencies_hz(max((group_frequencies_hz(g, trials) for g in groups), key=len))
    pooled: dict[float, dict[str, list[Array]]] = {}
    for group, payload_kg, part in _by_payload(residuals, rows):
        hz = group_frequencies_hz(group, trials)
        fraction = (len(part) - 1) / (len(part) - 1 + max(floor.repeats - 1, 1))
        within = smooth_variance(part) if len(part) > 1 else np.zeros(part.shape[1:])
        for signal, variance in zip(group.signals, within, strict=True):
            if signal not in floor.noise:
                continue
            expected = np.interp(hz, floor.frequency_hz, floor.noise[signal])
            here = variance / np.maximum(expected, np.finfo(float).tiny)
            ratio = (1 - fraction) * known.noise_at(signal, payload_kg, hz) + fraction * here
            own = pooled.setdefault(payload_kg, {}).setdefault(signal, [])
            own.append(np.interp(at, hz, ratio))
    noise = {p: averaged(own) for p, own in pooled.items()}
    model = {p: {s: known.model_at(s, p, at) for s in own} for p, own in noise.items()}
    return replace(floor, ratios=PayloadRatios(at, noise, model))


def with_amplified_scatter(
    floor: NoiseFloor, residuals: Residuals, rows: Sequence[Array]
) -> NoiseFloor:
    """Floor that is larger at payloads whose diagnosed repetitions differ far more than expected.

    Near the moment that folds the link every small difference is amplified: friction and pressure
    between trials, and the plant's own error alike. The ratio of the scatter of repetitions to that
    of the floor gives the factor. Floor and repetitions are two estimates; their mean counts, and
    only beyond `GapSettings.amplified_scatter_limit`, because ratios of so few trials scatter.

    Shapes: `rows` (trials, signals, K).
    """
    if not floor.learned:
        return floor
    limit = residuals.settings.amplified_scatter_limit
    found: dict[float, list[float]] = {}
    for group, payload_kg, part in _by_payload(residuals, rows):
        if len(part) > 1:
            hz = group_frequencies_hz(group, residuals.trials)
            ratio = _scatter_ratio(floor, group, part, payload_kg, hz)
            found.setdefault(payload_kg, []).append(ratio)
    scatter = {p: float(np.mean(own)) for p, own in found.items()}
    amplified = {p: (1 + ratio) / 2 for p, ratio in scatter.items() if ratio > limit}
    return replace(floor, amplification_power=amplified)


def _by_payload(
    residuals: Residuals, rows: Sequence[Array]
) -> Iterator[tuple[TrialGroup, float, Array]]:
    """Group, payload in kg, and spectra (repetitions, signals, K) of each payload of each group."""
    for group, residual in zip(residuals.groups, rows, strict=True):
        payloads = np.array([residuals.trials[k].meta.payload_kg for k in group.trials])
        for payload_kg in np.unique(payloads):
            yield group, float(payload_kg), residual[payloads == payload_kg]


def _scatter_ratio(
    floor: NoiseFloor, group: TrialGroup, repetitions: Array, payload_kg: float, hz: Array
) -> float:
    """Power of the scatter of repetitions over that of the floor, geometric mean below 2 Hz."""
    at = ratio_frequencies_hz(hz)
    at = at[at < SLOW_HZ]
    logarithms = []
    for signal, variance in zip(group.signals, smooth_variance(repetitions), strict=True):
        if signal in floor.noise:
            expected = np.interp(at, floor.frequency_hz, floor.noise[signal])
            expected = expected * floor.ratios.noise_at(signal, payload_kg, at)
            ratio = np.interp(at, hz, variance) / np.maximum(expected, np.finfo(float).tiny)
            logarithms.append(np.log(np.maximum(ratio, np.finfo(float).tiny)))
    return float(np.exp(np.mean(logarithms))) if logarithms else 1.0
