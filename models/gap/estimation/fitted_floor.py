"""Noise floor of a diagnosis: that of the plant file, completed or enlarged by the trials.

Signals that the plant file has no floor of get that of the nuisance fit's residual. Repeated trials
with a gap contain information on noise too: near its limit no two trials of a link are alike, and a
difference between repetitions is no missing effect. With two joints and 2 kg repetitions differed
by up to 350 times the power that those of the identification had shown.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from firmware_py.core.errors import InputError
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.residuals.residuals import Residuals
from models.plant.identification.noise_floor import (
    PayloadRatios,
    averaged,
    floor_from_record,
    floor_from_residuals,
    guessed_floor,
    ratio_frequencies_hz,
    smooth_variance,
)
from models.plant.identification.trial_spectra import TrialGroup, group_frequencies_hz
from models.plant.plant import Plant
from models.plant.step_model import Array

FLOOR_ROUNDS: Final = 2
"""Times that floor and nuisance are estimated in turn, where the plant file carries no floor
[assumed]."""
AMPLIFIED_SCATTER_LIMIT: Final = 2.7
"""Power by which repetitions differ, over what the floor expects, above which the floor at their
payload grows: the 95 % quantile of 78 ratios on unchanged links of 13 drawn rigs for tuning,
nothing hidden. On 26 changed links of these rigs residuals above 1.63 noise floors (1.8, 2.3, 3.2,
5.0) came with higher ratios only."""

SLOW_HZ: Final = 2.0
"""Frequency below which a heavy payload makes two trials differ
(`models.plant.identification.noise_floor`)."""


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
            by_signal = pooled.setdefault(payload_kg, {}).setdefault(signal, [])
            by_signal.append(np.interp(at, hz, ratio))
    noise = {p: averaged(by_signal) for p, by_signal in pooled.items()}
    model = {p: {s: known.model_at(s, p, at) for s in by_signal} for p, by_signal in noise.items()}
    return replace(floor, ratios=PayloadRatios(at, noise, model))


def with_amplified_scatter(
    floor: NoiseFloor, residuals: Residuals, rows: Sequence[Array]
) -> NoiseFloor:
    """Floor that is larger at payloads whose diagnosed repetitions differ far more than expected.

    Near the moment that folds the link every small difference is amplified: friction and pressure
    between trials, and the plant's own error alike. The ratio of the scatter of repetitions to that
    of the floor gives the factor. Floor and repetitions are two estimates; their mean counts, and
    only beyond `AMPLIFIED_SCATTER_LIMIT`, because ratios of so few trials scatter.

    Shapes: `rows` (trials, signals, K).
    """
    if not floor.learned:
        return floor
    ratios: dict[float, list[float]] = {}
    for group, payload_kg, part in _by_payload(residuals, rows):
        if len(part) > 1:
            hz = group_frequencies_hz(group, residuals.trials)
            ratio = _scatter_ratio(floor, group, part, payload_kg, hz)
            ratios.setdefault(payload_kg, []).append(ratio)
    scatter = {p: float(np.mean(of_groups)) for p, of_groups in ratios.items()}
    larger = {p: ratio for p, ratio in scatter.items() if ratio > AMPLIFIED_SCATTER_LIMIT}
    amplified = {p: (1 + ratio) / 2 for p, ratio in larger.items()}
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


def floor_of_nuisance_fit(residuals: Residuals) -> NoiseFloor:
    """Floor where the plant file carries none: the spectrum of the nuisance fit's residual.

    It is smoothed. The first one is guessed from the usual error of each signal.
    """
    groups, trials = residuals.groups, residuals.trials
    base = np.array([q.kind != "effect" for q in residuals.fit_parameters])
    floor = NoiseFloor.of(guessed_floor(residuals), learned=False)
    for _ in range(FLOOR_ROUNDS):
        estimator = GaussNewton(residuals, floor)
        point = estimator.fit(estimator.start(), base)
        measured = floor_from_residuals(groups, trials, point.rows, repeated=False)
        floor = NoiseFloor.of(measured, learned=False)
    return floor


def noise_floor_for(residuals: Residuals) -> NoiseFloor:
    """Floor of the plant file; signals that it lacks get the floor of the nuisance fit."""
    known = noise_floor_of(residuals.plant, residuals.trials[0].meta.dof)
    signals = {s for g in residuals.groups for s in g.signals}
    if known is not None and signals <= known.noise.keys():
        return known
    fitted = floor_of_nuisance_fit(residuals)
    if known is None:
        return fitted
    return known.completed_by(fitted)


def noise_floor_of(plant: Plant, dof: int) -> NoiseFloor | None:
    """Floor that the plant file carries for a number of joints; None if it carries none."""
    record = plant.provenance.noise_floor.get(str(dof))
    if record is None:
        return None
    try:
        return NoiseFloor.of(floor_from_record(record))
    except ValueError as error:
        raise InputError(
            f"plant {plant.name!r}", f"provenance.noise_floor.{dof} is damaged ({error})",
            "identify the plant again",
        ) from None  # fmt: skip
