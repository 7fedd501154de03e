"""Nuisance fit: what a plant misses although link, set-up and variation between trials are
refitted.

The noise floor depends on how much the repetitions at hand differ, and on the gap that remains, of
which a fraction is the error of the equation that closes it. So floor and fit are made in turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from models.gap.estimation.fitted_floor import (
    noise_floor_for,
    with_amplified_scatter,
    with_repeated_trials,
)
from models.gap.estimation.gauss_newton import RELATIVE_FALL, FitPoint, GaussNewton
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.residuals.fit_parameters import all_fit_parameters, is_known_elsewhere
from models.gap.residuals.residuals import Residuals
from models.plant.plant import Plant
from models.trials.trial import Trial

LEAST_GAP: Final = 1.05
"""Mean squared residual below which nothing is left of a gap [assumed]."""
ROUNDS: Final = 2
"""Times that floor and nuisance are estimated in turn [assumed]."""


@dataclass(frozen=True)
class NuisanceFit:
    """Fit of nuisance and variation between trials, without any effect."""

    estimator: GaussNewton  # Its floor allows for the error of the equation that closes the gap
    measured: GaussNewton  # The same against the floor as measured
    point: FitPoint

    def mean_residual(self, point: FitPoint) -> float:
        """Mean squared residual of a fit, in noise floors as measured."""
        return self.measured.mean_square(point)

    def left_fraction(self, point: FitPoint) -> float | None:
        """Fraction of the gap's amplitude that a fit leaves, beyond noise; 1 without a gap.

        None without a learned noise floor: noise and gap cannot be told apart.
        """
        if not self.measured.floor.learned:
            return None
        before, after = (self.mean_residual(p) for p in (self.point, point))
        if before < LEAST_GAP:
            return 1.0
        return min(float(np.sqrt(max(after - 1.0, 0.0) / (before - 1.0))), 1.0)


def nuisance_fit_of(
    plant: Plant, trials: Sequence[Trial], catalogue: Sequence[str], same_link: bool
) -> NuisanceFit:
    """What a plant misses on some trials although link, set-up and variation are refitted.

    The fit parameters of the catalogue's effects are those of a search that follows.
    """
    is_known = is_known_elsewhere(plant, trials)
    parameters = all_fit_parameters(plant, trials, catalogue, is_known, same_link)
    residuals = Residuals(plant, trials, parameters)
    floor = noise_floor_for(residuals)
    estimator = GaussNewton(residuals, floor)
    point, measured = estimator.start(), floor
    for k in range(ROUNDS):
        if k:
            measured = _with_scatter(floor, residuals, point)
        gap = [r - m for r, m in zip(point.rows, estimator.means, strict=True)]
        wider = measured.widened(residuals.groups, residuals.trials, gap)
        estimator = GaussNewton(residuals, wider)
        is_last = k == ROUNDS - 1  # the floor alone follows from those before
        point = estimator.fit_nuisance(
            estimator.at(point.values), 0.0 if is_last else RELATIVE_FALL
        )
    return NuisanceFit(estimator, GaussNewton(residuals, measured), point)


def _with_scatter(floor: NoiseFloor, residuals: Residuals, point: FitPoint) -> NoiseFloor:
    """Floor at the scatter of the repetitions at hand.

    With two joints repetitions differ so much that the scatter is pooled with the floor's; with one
    joint that would discount effects that vary, so only a far larger scatter counts.
    """
    pooled = residuals.trials[0].meta.dof > 1
    repeated = with_repeated_trials if pooled else with_amplified_scatter
    return repeated(floor, residuals, point.rows)
