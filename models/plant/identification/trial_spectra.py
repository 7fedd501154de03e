"""Spectra of trials, and the groups of trials whose spectra can be compared.

The spectrum is a cosine transform in which a stationary error is nearly uncorrelated. The
orthonormal DCT-II of a trial of n samples has coefficients at k / (2 n h); those up to `HIGHEST_HZ`
are used. The variance of a coefficient is the noise's spectrum at its frequency, which accounts for
autocorrelation: a slow error fills few coefficients, so it counts as few samples.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.fft import dct, idct

from firmware_py.core.errors import InputError
from models.plant.identification.evaluation import nothing_measured
from models.plant.identification.fit import measured_signals, with_rows
from models.plant.step_model import Array
from models.trials.trial import Trial, TrialSet, motion_start

HIGHEST_HZ: Final = 8.0
"""Highest frequency of the spectra; the first mode lies at 1.4 to 3.5 Hz (docs/sources.md, "The
link")."""


def coefficient_count(samples: int, step_s: float) -> int:
    """Number of coefficients of a trial that are used."""
    return min(samples, max(4, int(2 * samples * step_s * HIGHEST_HZ)))


def coefficient_frequencies_hz(coefficients: int, samples: int, step_s: float) -> Array:
    """Frequencies of the first coefficients of a trial, shape (K,)."""
    return np.arange(coefficients) / (2 * samples * step_s)


def cosine_transform(rows: Array, coefficients: int) -> Array:
    """First coefficients (K, ...) of rows (n, ...)."""
    return np.asarray(dct(rows, type=2, norm="ortho", axis=0)[:coefficients])


def inverse_cosine_transform(coefficients: Array, samples: int) -> Array:
    """Rows (n, ...) of coefficients (K, ...)."""
    return np.asarray(idct(coefficients, type=2, norm="ortho", axis=0, n=samples))


def smoothed(power: Array, width_fraction: float = 0.25, least_coefficients: int = 4) -> Array:
    """Mean of power (..., K) over neighbouring coefficients.

    The half width of the window is a fraction of the frequency, at least some coefficients
    [assumed].
    """
    count = power.shape[-1]
    total = np.concatenate([np.zeros((*power.shape[:-1], 1)), np.cumsum(power, axis=-1)], axis=-1)
    half = np.maximum(least_coefficients, (width_fraction * np.arange(count)).astype(int))
    low = np.maximum(np.arange(count) - half, 0)
    high = np.minimum(np.arange(count) + half + 1, count)
    return np.asarray((total[..., high] - total[..., low]) / (high - low))


# Groups of trials of one motion

LEAST_COEFFICIENTS: Final = 12  # of a trial: three bands of four [assumed]


@dataclass(frozen=True)
class TrialGroup:
    """Trials of one motion, whose spectra can be compared coefficient by coefficient."""

    key: str  # See `trial_group_key`
    trials: tuple[int, ...]
    signals: tuple[str, ...]  # Signals that both simulation and measurement have
    coefficients: int  # Number of coefficients that are used


def trial_group_key(trial: Trial) -> str:
    """Key of a trial's conditions apart from payload and repetition."""
    m = trial.meta
    conditions = "".join(f" {name}={value:.5g}" for name, value in sorted(m.conditions.items()))
    return (
        f"{m.dof}dof {m.motion} {m.amplitude_rad:.5g}rad {m.period_s:.5g}s {m.phase_2_rad:.4g}rad "
        f"{len(trial)}x{trial.step_s:.5g}s{conditions}"
    )


def check_duration(trial: Trial) -> None:
    """Refuse a trial that is too short to have a spectrum."""
    if coefficient_count(len(trial), trial.step_s) < LEAST_COEFFICIENTS:
        raise InputError(
            trial.path if trial.path.name else trial.name,
            f"lasts {len(trial) * trial.step_s:.2g} s",
            f"give at least {LEAST_COEFFICIENTS / (2 * HIGHEST_HZ):.2g} s of motion",
        )


def aligned(trials: TrialSet) -> TrialSet:
    """Trials whose rest is that of their goals; those of one motion get equal rests and ends.

    Trials are not cut to match one whose motion is shorter by more than a tenth [assumed].
    """
    starts = [motion_start(t) for t in trials]
    motions: dict[str, list[int]] = defaultdict(list)
    for k, trial in enumerate(trials):
        motions[trial_group_key(with_rows(trial, slice(2), 0))].append(k)  # whatever its length
    result = list(trials)
    for members in motions.values():
        rest, common = min(starts[k] for k in members), 0
        moving = {k: len(result[k]) - starts[k] for k in members}
        for k in sorted(members, key=moving.__getitem__):
            if 0.9 * moving[k] > common:
                common = moving[k]
            result[k] = with_rows(result[k], slice(starts[k] - rest, starts[k] + common), rest)
    return TrialSet(tuple(result))


def trial_groups(trials: Sequence[Trial], outputs: Sequence[str]) -> list[TrialGroup]:
    """Groups of the trials, with the signals that were measured and are simulated."""
    members: dict[tuple[str, tuple[str, ...]], list[int]] = defaultdict(list)
    for k, trial in enumerate(trials):
        measured = measured_signals(trial)
        signals = tuple(s for s in outputs if s in measured and np.isfinite(measured[s]).any())
        if not signals:
            raise nothing_measured(trial, outputs)
        check_duration(trial)
        members[trial_group_key(trial), signals].append(k)
    result = []
    for (key, signals), rows in members.items():
        first = trials[rows[0]]
        count = coefficient_count(len(first), first.step_s)
        result.append(TrialGroup(key, tuple(rows), signals, count))
    return result


def group_frequencies_hz(group: TrialGroup, trials: Sequence[Trial]) -> Array:
    """Frequencies of the coefficients of a group, shape (K,)."""
    first = trials[group.trials[0]]
    return coefficient_frequencies_hz(group.coefficients, len(first), first.step_s)
