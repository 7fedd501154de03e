"""Whether the nuisance had to stretch: trials that vary alike do not vary at random.

Eccentricity of the payload, clock and frame differ from trial to trial by little and by chance
(`models.gap.residuals.fit_parameters.TRIAL_SPREAD`). An effect that is not in the catalogue hides
in them: an offset
of the payload as the same eccentricity in every trial, hardly outside of each trial's prior and far
outside of that of all. For each kind of variation, with θ_t in standard deviations of its prior,

    z = Σ θ_t / √n

is at most standard normal where trials vary by chance: the fit draws θ_t towards zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.residuals.fit_parameters import FitParameter

STRAINED: Final = 8.0
"""Least |z| that is too much to be chance [set on development cases: up to 4.4 where nothing had
gone into the variation, 15 to 24 where a denied payload offset, clock or dead time had]."""

PLACED: Final = ("eccentricity_m", "frame_m", "sync_s")
"""How things were set up. Pressure and friction also take up what equations miss: z was 4 with
nothing hidden, 9 beside a softening that was rightly named."""


def nuisance_biases(knobs: Sequence[FitParameter], point: FitPoint) -> dict[str, float]:
    """Sum z by kind of variation, see the module's text.

    Parameters
    ----------
    knobs : sequence of FitParameter
        Of the problem.
    point : FitPoint
        Fit of the nuisance, with what was named.
    """
    shares: dict[str, list[float]] = {}
    for knob, value in zip(knobs, point.values, strict=True):
        if knob.kind == "trial" and knob.name in PLACED:
            kind = " ".join([knob.name, *knob.outputs])
            shares.setdefault(kind, []).append(float(value) / knob.spread)
    return {kind: float(np.sum(z) / np.sqrt(len(z))) for kind, z in shares.items()}


def excessive_nuisance_bias(knobs: Sequence[FitParameter], point: FitPoint) -> dict[str, float]:
    """Those kinds whose z is too large."""
    return {kind: z for kind, z in nuisance_biases(knobs, point).items() if abs(z) > STRAINED}
