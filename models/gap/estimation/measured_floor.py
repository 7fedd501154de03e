"""Noise floor measured on residuals of trials without a gap, or guessed before any are known.

Repeated trials with a gap contain information on noise too: near its limit no two trials of a link
are alike, and a difference between repetitions is no missing effect. With two joints and 2 kg
repetitions differed by up to 350 times the power that those of the identification had shown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from models.gap.estimation.noise_floor import NoiseFloor, group_frequencies_hz, smoothed
from models.gap.estimation.payload_ratios import (
    NO_RATIOS,
    PayloadRatios,
    payload_ratios,
    ratio_frequencies_hz,
    smooth_variance,
)
from models.gap.residuals.residuals import Residuals, TrialGroup
from models.gap.residuals.spectrum import Array
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.trials.trial import Trial

SLOW_HZ: Final = 2.0
"""Frequency below which a heavy payload makes two trials differ
(`models.gap.estimation.payload_ratios`)."""


def flat_floor(
    signals: Sequence[str],
    scale: Mapping[str, float],
    settings: GapSettings = DEFAULT_SETTINGS,
) -> NoiseFloor:
    """Flat floor with given errors by signal, for a first fit."""
    hz = np.array([0.0, 1e3])
    count = settings.samples_per_independent_sample
    noise = {s: np.full(2, count * scale[s] ** 2) for s in signals}
    return NoiseFloor(hz, noise, {s: np.zeros(2) for s in signals}, learned=False)


def floor_of_residual(
    groups: Sequence[TrialGroup],
    trials: Sequence[Trial],
    rows: Sequence[Array],
    settings: GapSettings = DEFAULT_SETTINGS,
) -> NoiseFloor:
    """Floor that equals the smoothed spectrum of a residual."""
    return floor_from_residuals(groups, trials, rows, settings, repeated=False)


def floor_from_residuals(
    groups: Sequence[TrialGroup],
    trials: Sequence[Trial],
    rows: Sequence[Array],
    settings: GapSettings = DEFAULT_SETTINGS,
    repeated: bool = True,
) -> NoiseFloor:
    """Floor from residuals of data without a gap.

    `repeated`: whether repetitions separate noise from the model's error; otherwise all is noise.
    Shapes: `rows` (trials, signals, K).
    """
    hz = max((group_frequencies_hz(g, trials) for g in groups), key=len)
    signals = list(dict.fromkeys(s for g in groups for s in g.signals))
    noise: dict[str, list[Array]] = {s: [] for s in signals}
    model: dict[str, list[Array]] = {s: [] for s in signals}
    curves: dict[str, dict[float, dict[str, Array]]] = {}
    rest_s: dict[str, float] = {}
    ratios = NO_RATIOS
    repeats = []
    for group, residual in zip(groups, rows, strict=True):
        own = group_frequencies_hz(group, trials)
        payloads = np.array([trials[k].meta.payload_kg for k in group.trials])
        by_payload = {float(p): residual[payloads == p] for p in np.unique(payloads)}
        parts = list(by_payload.values())
        within = [np.sum((p - p.mean(axis=0)) ** 2, axis=0) for p in parts if len(p) > 1]
        freedom = sum(len(p) - 1 for p in parts)
        split = repeated and freedom > 0
        for b, signal in enumerate(group.signals):
            if split:
                varying = smoothed(sum(w[b] for w in within) / freedom, settings)
            else:
                varying = smoothed(np.mean(residual[:, b] ** 2, axis=0), settings)
            mean_power = np.mean([p.mean(axis=0)[b] ** 2 for p in parts], axis=0)
            repeats.append(count := len(group.trials) / len(parts))
            standing = np.maximum(smoothed(mean_power, settings) - varying / count, 0.0)
            noise[signal].append(np.interp(hz, own, varying))
            model[signal].append(np.interp(hz, own, standing if split else 0 * varying))
        if split:
            if ratios is NO_RATIOS:
                ratios = payload_ratios(own, group.signals, by_payload)
            first = trials[group.trials[0]]
            rest_s.setdefault(group.key, first.meta.rest_samples * first.step_s)
            for p, part in by_payload.items():
                own_curves = curves.setdefault(group.key, {}).setdefault(p, {})
                for s, curve in zip(group.signals, part.mean(axis=0), strict=True):
                    own_curves.setdefault(s, curve)
    return NoiseFloor(
        hz, _averaged(noise), _averaged(model), curves, float(np.mean(repeats)), repeated,
        rest_s=rest_s, ratios=ratios,
    )  # fmt: skip


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
    noise = {p: _averaged(own) for p, own in pooled.items()}
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


def _averaged(table: Mapping[str, Sequence[Array]]) -> dict[str, Array]:
    return {signal: np.mean(rows, axis=0) for signal, rows in table.items()}
