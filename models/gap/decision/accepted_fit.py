"""Fit that the improved plant is written from, and whether its nuisance is written as refitted."""

from __future__ import annotations

from dataclasses import dataclass

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.held_out_errors import HeldOutErrors
from models.gap.settings import GapSettings
from models.plant.identification.noise_floor import Array


@dataclass(frozen=True)
class AcceptedFit:
    point: FitPoint  # Values of all fit parameters
    free: Array  # (p,), fit parameters that were fitted; none for the unchanged plant
    errors: HeldOutErrors  # Held-out errors of this fit


def refit_is_earned(
    undone: HeldOutErrors, refitted: HeldOutErrors, given: HeldOutErrors, settings: GapSettings
) -> bool:
    """Whether the refitted nuisance is better than that of the diagnosed plant.

    `undone`, `refitted`: errors with the effects, without and with a refitted nuisance.
    """
    before, after = (max(fit.ratios(given).values()) for fit in (undone, refitted))
    falls = refitted.fraction_of(undone) < 1 - settings.harm_fraction
    return falls and after <= max(before, 1.0)
