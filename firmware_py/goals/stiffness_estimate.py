"""Estimate of a link's stiffness beyond the plant's, from the current along a plan.

With the payload known, a link that is stiffer than the plant believes bends less, and its current
differs from the plan's by a curve that planning has computed (`StiffnessSlopes`). The relative
stiffness is estimated by recursive least squares beside a deviation of friction and a constant
current of each joint [Ljung, *System Identification* (1999), section 11.2].
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["StiffnessEstimate"]

Array = NDArray[np.float64]
CURRENT_DEVIATION_A: Final = 0.25
"""Deviation of a sample of the current. Measured on the rig: 0.055 A around the best fit with a
correlation of 0.9 from sample to sample, which counts as 0.24 A of white noise."""
PRIOR_DEVIATION: Final = 0.1
"""Standard deviation of the relative stiffness before a run [assumed: pressure, temperature]."""
FRICTION_DEVIATION: Final = 0.3
"""Of the relative friction; the rig's plans show 0.15 to 0.25."""
BIAS_DEVIATION_A: Final = 0.05
"""Of the constant current; an eccentric payload of 3 mm makes 0.01 A."""
MOST: Final = 0.3
"""Largest magnitude of the relative stiffness that the goals follow [assumed]."""


class StiffnessEstimate:
    """Recursive least squares of relative stiffness, friction and constant current.

    Parameters
    ----------
    dof : int
        Number of joints.

    Attributes
    ----------
    value : float
        Relative stiffness beyond the plant's, within ±`MOST`.
    """

    def __init__(self, dof: int) -> None:
        self._dof = dof
        self._theta = np.zeros(1 + 2 * dof)
        deviations = [PRIOR_DEVIATION, *[FRICTION_DEVIATION] * dof, *[BIAS_DEVIATION_A] * dof]
        self._covariance: Array = np.diag(np.square(deviations))
        self._row = np.zeros(1 + 2 * dof)
        self.value = 0.0

    def update(
        self, excess_a: Array, by_stiffness: Array, by_friction: Array, weight: Array
    ) -> None:
        """Take the currents of one fresh sample.

        Parameters
        ----------
        excess_a : ndarray, shape (dof,)
            Measured currents beyond those of a link that is as stiff as the plant.
        by_stiffness, by_friction : ndarray, shape (dof,)
            Slopes of the currents.
        weight : ndarray, shape (dof,)
            Weight of each sample, 0 to 1.
        """
        theta, covariance, row, dof = self._theta, self._covariance, self._row, self._dof
        for j in range(dof):
            w = float(weight[j])
            innovation = float(excess_a[j])
            if w <= 0.0 or not math.isfinite(innovation):
                continue
            row[:] = 0.0
            row[0], row[1 + j], row[1 + dof + j] = by_stiffness[j], by_friction[j], 1.0
            gain = covariance @ row
            variance = CURRENT_DEVIATION_A**2 + w * float(row @ gain)
            innovation -= float(row @ theta)
            limit = 3.0 * math.sqrt(variance)
            theta += gain * (w / variance * min(max(innovation, -limit), limit))
            covariance -= (w / variance) * np.outer(gain, gain)
        self.value = min(max(float(theta[0]), -MOST), MOST)
