"""Outlier trials, which differ from the plant far more than comparable ones: disturbed or
mislabelled.

An effect shows alike in repetitions, and at a payload between two others no more than at these. A
trial whose residual lies far above that of comparable trials is faulty itself, so it must not lead
to the name of an effect.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.noise_floor import NoiseFloor
from models.plant.identification.noise_floor import LEAST_NOISE_FRACTION
from models.plant.identification.trial_spectra import group_frequencies_hz
from models.shared.kinematics import Array
from models.trials.trial import TrialSet

TRIAL_RATIO: Final = 3.0
"""Ratio of a trial's error to that of the other trials of its motion, in noise floors, above which
it is left out as an outlier, where no trial repeats it [assumed]."""
REPETITION_RATIO: Final = 2.0
"""The same ratio to its repetitions: a quarter more than the largest of 180 pairs of repetitions on
12 drawn rigs for tuning, effects hidden in 48 of 60 data sets."""


@dataclass(frozen=True)
class OutlierTrial:
    """Outlier trial that is left out of a diagnosis."""

    name: str
    path: str
    payload_kg: float  # Payload in the trial's conditions
    floors: float  # Root mean square difference from the plant, in noise floors
    # The same of its repetitions, or of the other trials of its motion if it has none
    floors_of_comparable: float


def outlier_trials(estimator: GaussNewton, point: FitPoint) -> tuple[OutlierTrial, ...]:
    """Trials whose residual lies far above that of comparable trials.

    The limit is `REPETITION_RATIO` times their repetitions, or `TRIAL_RATIO` times the others where
    there are none. At most a third of a motion's trials are returned, those
    that differ most.
    """
    trials = estimator.residuals.trials
    outliers: list[OutlierTrial] = []
    groups = zip(estimator.residuals.groups, point.rows, estimator.means, strict=True)
    for group, rows, mean in groups:
        members = [trials[k] for k in group.trials]
        payloads = np.array([t.meta.payload_kg for t in members])
        hz = group_frequencies_hz(group, trials)
        levels = _levels(estimator.floor, group.signals, payloads, hz, rows - mean)
        both = [_level_of_comparable(k, levels, payloads) for k in range(len(members))]
        comparable, ratios = zip(*both, strict=True)
        above = [k for k in np.argsort(-levels) if levels[k] > ratios[k] * max(comparable[k], 1.0)]
        outliers += [
            OutlierTrial(
                members[k].name,
                str(members[k].path),
                payloads[k].item(),
                levels[k].item(),
                comparable[k],
            )
            for k in above[: len(members) // 3]
        ]
    return tuple(outliers)


def without_outliers(trials: TrialSet, outliers: Collection[OutlierTrial]) -> TrialSet:
    """Trials without the outliers."""
    left_out = {(o.name, o.path) for o in outliers}
    return trials.where(lambda t: (t.name, str(t.path)) not in left_out)


def _levels(
    floor: NoiseFloor, signals: Sequence[str], payloads_kg: Array, hz: Array, rows: Array
) -> Array:
    """Root mean square residual of each trial in noise floors; the floor is not amplified."""
    power = []
    for b, signal in enumerate(signals):
        if signal not in floor.noise:
            continue
        noise, model = (
            np.interp(hz, floor.frequency_hz, table[signal]) for table in (floor.noise, floor.model)
        )
        variances = [
            noise * floor.ratios.noise_at(signal, p, hz)
            + model * floor.ratios.model_at(signal, p, hz)
            for p in payloads_kg
        ]
        # A signal of a simulation may have no noise at all.
        least = LEAST_NOISE_FRACTION * max(float(np.max(variances)), 1e-12)
        expected = np.maximum(variances, least)
        power.append(np.mean(rows[:, b] ** 2 / expected, axis=1))
    return np.sqrt(np.mean(power, axis=0)) if power else np.zeros(len(rows))


def _level_of_comparable(trial: int, levels: Array, payloads_kg: Array) -> tuple[float, float]:
    """Level of a trial's repetitions, else of all others, and the largest usual ratio to it.

    An effect may show at the smallest or the largest payload alone, so without repetitions the
    level is infinite unless the payload lies between two others.
    """
    others = np.arange(len(levels)) != trial
    repeated = others & (payloads_kg == payloads_kg[trial])
    if repeated.any():
        return float(np.median(levels[repeated])), REPETITION_RATIO
    loads = payloads_kg[others]
    between = len(loads) and loads.min() < payloads_kg[trial] < loads.max()
    return float(levels[others].max()) if between else np.inf, TRIAL_RATIO
