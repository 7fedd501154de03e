"""Nuisance bias: a variation between trials that is the same in all of them.

Place of the payload, frame, friction and pressure differ from trial to trial by little and by
chance (`trial_variation`). A missing effect can hide in them: an offset of the payload appears as
the same eccentricity in every trial, a larger friction beside a named dead time as more friction in
every trial, hardly outside of each trial's prior and far outside of that of all. For each kind of
variation, with θ_t in standard deviations of its prior,

    z = Σ θ_t / √n

is at most standard normal where trials vary by chance: the fit shrinks θ_t towards zero. The mean
of the trials' clocks is held at zero in the fit (`models.gap.residuals.prior`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.residuals.fit_parameters import FitParameter
from models.gap.settings import DEFAULT_SETTINGS, GapSettings

CHANGES_WITH_LINK: Final = frozenset({"pressure"})
"""Kinds that are tested on an unchanged link only: a changed link shifts them in all trials alike.
On a link that was 20 % stiffer throughout z of the pressure was 11."""


def nuisance_biases(
    fit_parameters: Sequence[FitParameter],
    point: FitPoint,
    settings: GapSettings = DEFAULT_SETTINGS,
) -> dict[str, float]:
    """Sum z by kind of variation, see the module's docstring."""
    by_kind: dict[str, list[float]] = {}
    kinds = set(settings.nuisance_bias_kinds)
    if not settings.same_link:
        kinds -= CHANGES_WITH_LINK
    for q, value in zip(fit_parameters, point.values, strict=True):
        if q.kind == "trial" and q.name in kinds:
            kind = " ".join([q.name, *q.outputs])
            by_kind.setdefault(kind, []).append(float(value) / q.standard_deviation)
    return {kind: float(np.sum(z) / np.sqrt(len(z))) for kind, z in by_kind.items()}


def excessive_nuisance_bias(
    fit_parameters: Sequence[FitParameter],
    point: FitPoint,
    settings: GapSettings = DEFAULT_SETTINGS,
) -> dict[str, float]:
    """Those of `nuisance_biases` that are too large to be chance."""
    biases = nuisance_biases(fit_parameters, point, settings)
    return {kind: z for kind, z in biases.items() if abs(z) > settings.nuisance_bias_limit_sd}
