"""Nuisance fit: what a plant misses although link, set-up and variation between trials are
refitted.

The noise floor depends on the gap that remains: on the change of the link, which enlarges the
plant's own error; on how much the repetitions at hand differ; and on the gap itself, of which a
fraction is the error of the equation that closes it. So floor and fit are made in turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from models.gap.estimation.fitted_floor import with_amplified_scatter, with_repeated_trials
from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.link_change import link_change
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.residuals.residuals import Residuals

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

    def left_fraction(self, point: FitPoint) -> float:
        """Fraction of the gap's amplitude that a fit leaves, beyond noise; 1 without a gap."""
        before, after = (self.mean_residual(p) for p in (self.point, point))
        if before < LEAST_GAP:
            return 1.0
        return min(float(np.sqrt(max(after - 1.0, 0.0) / (before - 1.0))), 1.0)


def nuisance_fit_of(residuals: Residuals, floor: NoiseFloor, same_link: bool) -> NuisanceFit:
    """Fit the nuisance of some residuals; `same_link`: the link is known to be unchanged."""
    estimator = GaussNewton(residuals, floor)
    point = estimator.start()
    for _ in range(ROUNDS):
        measured = _measured_floor(floor, residuals, point, same_link)
        gap = [r - m for r, m in zip(point.rows, estimator.means, strict=True)]
        wider = measured.widened(residuals.groups, residuals.trials, gap)
        estimator = GaussNewton(residuals, wider)
        point = estimator.fit_nuisance(estimator.at(point.values))
    return NuisanceFit(estimator, GaussNewton(residuals, measured), point)


def _measured_floor(
    floor: NoiseFloor, residuals: Residuals, point: FitPoint, same_link: bool
) -> NoiseFloor:
    """Floor at the change of the link, and at the scatter of the repetitions at hand.

    With two joints repetitions differ so much that the scatter is pooled with the floor's; with one
    joint that would discount effects that vary, so only a far larger scatter counts.
    """
    change = link_change(residuals.fit_parameters, point.values, same_link)
    floor = replace(floor, link_change=change)
    if not np.any(point.values):  # before the first fit
        return floor
    pooled = residuals.trials[0].meta.dof > 1
    repeated = with_repeated_trials if pooled else with_amplified_scatter
    return repeated(floor, residuals, point.rows)
