"""Outlier repetitions: trials whose variation differs far more than two repetitions usually do.

The variation of a trial (friction, clock, place of the payload, …) is fitted within its prior, and
absorbs most of the error of a disturbed trial. Two repetitions of one robot differ in it by √2 of
its standard deviation; a far larger difference means that one of the two is disturbed. The
disturbed one is the one without which the rest fits better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.noise_floor_fit import nuisance_and_variation
from models.gap.odd_trials import OddTrial, odd_trials
from models.gap.residuals.residuals import Residuals
from models.gap.settings import GapSettings
from models.plant.plant import Plant
from models.shared.kinematics import Array
from models.trials.trial import Trial, TrialSet

FEWEST: Final = 3
"""Fewest trials of a motion of which one may be left out."""
RELATIVE: Final = ("pressure", "friction")
"""Kinds of variation that are fractions of a value. A hidden friction that all trials share is
first absorbed as their median: what varies is a fraction of the larger value."""


@dataclass(frozen=True)
class VariationDifference:
    """Difference of two repetitions in one kind of variation."""

    trials: tuple[int, int]
    variation: str
    standard_deviations: float  # In standard deviations of such a difference


def disturbed_trials(
    estimator: GaussNewton, point: FitPoint, floor: NoiseFloor
) -> tuple[OddTrial, ...]:
    """Outlier trials: by their residual, or else by their variation.

    `floor`: noise floor of these trials, not widened by the gap.
    """
    odd = odd_trials(estimator, point)
    return odd or odd_repetitions(estimator.residuals, point.values, floor)


def odd_repetitions(residuals: Residuals, values: Array, floor: NoiseFloor) -> tuple[OddTrial, ...]:
    """The disturbed one of the two repetitions that differ most; empty where none differs too much.

    `values` has shape (p,): all fit parameters, with link, set-up and variation refitted.
    """
    settings, trials = residuals.settings, residuals.trials
    found = differing_repetitions(residuals, values)
    if not found or found[0].standard_deviations < settings.odd_variation_sd:
        return ()
    most = found[0]
    costs = [_cost_without(residuals.plant, trials, k, floor, settings) for k in most.trials]
    odd = trials[most.trials[int(np.argmin(costs))]]
    return (
        OddTrial(
            odd.name, str(odd.path), odd.meta.payload_kg,
            variation=most.variation, standard_deviations=most.standard_deviations,
        ),
    )  # fmt: skip


def differing_repetitions(residuals: Residuals, values: Array) -> list[VariationDifference]:
    """Largest difference between every two repetitions, the largest first."""
    by_trial: list[dict[str, float]] = [{} for _ in residuals.trials]
    rows = list(zip(residuals.fit_parameters, values.tolist(), strict=True))
    for q, value in rows:
        if q.trial is not None:
            shared = np.median([v for p, v in rows if p.trial is not None and p.name == q.name])
            size = 1 + abs(float(shared)) if q.name in RELATIVE else 1.0
            by_trial[q.trial][q.name] = value / (size * q.standard_deviation)
    result = []
    for group in (g for g in residuals.groups if len(g.trials) >= FEWEST):
        for pair in combinations(group.trials, 2):
            first, second = (residuals.trials[k].meta.payload_kg for k in pair)
            if first == second and (own := _difference(pair, *(by_trial[k] for k in pair))):
                result.append(own)
    return sorted(result, key=lambda row: -row.standard_deviations)


def _difference(
    pair: tuple[int, int], first: dict[str, float], second: dict[str, float]
) -> VariationDifference | None:
    """Largest difference between two trials; None where nothing varies."""
    sizes = {name: abs(first[name] - second[name]) / np.sqrt(2.0) for name in first}
    if not sizes:
        return None
    name = max(sizes, key=lambda kind: sizes[kind])
    return VariationDifference(pair, name, float(sizes[name]))


def _cost_without(
    plant: Plant, trials: Sequence[Trial], left_out: int, floor: NoiseFloor, settings: GapSettings
) -> float:
    """Cost of the nuisance fit to all trials but one."""
    rest = TrialSet(tuple(t for k, t in enumerate(trials) if k != left_out))
    parameters = nuisance_and_variation(plant, rest.trials, settings)
    estimator = GaussNewton(Residuals(plant, rest.trials, parameters, settings), floor)
    return estimator.fit_nuisance(estimator.start()).cost
