"""Fit that the improved plant is written from, and whether its nuisance is written as refitted."""

from __future__ import annotations

from dataclasses import dataclass

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.residuals.spectrum import Array
from models.gap.search.held_out_errors import HeldOutErrors
from models.gap.settings import GapSettings


@dataclass(frozen=True)
class AcceptedFit:
    """Fit that the improved plant is written from."""

    point: FitPoint  # Values of all fit parameters
    free: Array  # (p,), fit parameters that were fitted; none for the plant as given
    errors: HeldOutErrors  # Of this fit, each part left out in turn


def refit_is_earned(
    undone: HeldOutErrors, refitted: HeldOutErrors, given: HeldOutErrors, settings: GapSettings
) -> bool:
    """Whether a nuisance is better written as refitted than as in the plant as given.

    `undone`, `refitted`: of the effects with the nuisance as given, and as refitted beside them.
    """
    before, after = (max(fit.ratios(given).values()) for fit in (undone, refitted))
    falls = refitted.fraction_of(undone) < 1 - settings.harm_fraction
    return falls and after <= max(before, 1.0)
