"""First mode of the link at rest, from the twin linearised there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.plan.twin_sensitivity import TipTwin

Array = NDArray[np.float64]
MOST_DAMPED: Final = 0.5
"""Damping ratio above which a mode does not count as vibration [assumed]."""
SEEN: Final = 0.1
"""Least part of the tip's largest modal motion along an axis for a mode to count [assumed]."""


@dataclass(frozen=True)
class VibrationMode:
    rate_rad_s: float  # Natural angular frequency, undamped
    damping_ratio: float  # Fraction of the critical damping

    @property
    def half_period_s(self) -> float:
        """Half of the period of the damped vibration."""
        return math.pi / (self.rate_rad_s * math.sqrt(1.0 - self.damping_ratio**2))

    @property
    def decay(self) -> float:
        """Amplitude after half a period over that before."""
        return math.exp(-self.damping_ratio * self.rate_rad_s * self.half_period_s)


def first_modes(twin: TipTwin, goal_rad: Array, payload_kg: float) -> list[VibrationMode]:
    """Slowest vibration of the tip along each planned axis, about rest.

    Shapes: `goal_rad` (dof,).
    """
    by_state, tip_by_state = twin.derivatives_at_rest(goal_rad, payload_kg)
    values, vectors = np.linalg.eig(by_state)
    poles = np.log(values[np.abs(values) > 1e-6]) / twin.period_s
    seen = np.abs(tip_by_state @ vectors[:, np.abs(values) > 1e-6])
    found = []
    for axis in seen:
        rate = np.abs(poles)
        damping = -poles.real / np.maximum(rate, 1e-12)
        own = (poles.imag > 1e-6) & (damping > 0) & (damping < MOST_DAMPED)
        own &= axis > SEEN * axis[own].max(initial=0.0)
        if not own.any():
            raise ValueError(f"the tip has no vibration with {payload_kg:g} kg")
        k = int(np.flatnonzero(own)[np.argmin(rate[own])])
        found.append(VibrationMode(float(rate[k]), float(damping[k])))
    return found
