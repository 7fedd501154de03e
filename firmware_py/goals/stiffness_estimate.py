"""Estimate of a link's stiffness relative to the plant's, from the current along a plan.

At a known payload, a link that is stiffer than the plant bends less, and its current differs from
the plan's by a curve that planning has computed (`StiffnessSlopes`). Recursive least squares
estimate the relative stiffness together with a deviation of friction and a constant current of each
joint [Ljung, *System Identification* (1999), section 11.2].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

__all__ = ["StiffnessEstimate"]

CURRENT_DEVIATION_A: Final = 0.25
"""Standard deviation of a sample of the current. Measured on the rig: 0.055 A around the best fit
with a correlation of 0.9 from sample to sample, which counts as 0.24 A of white noise."""
PRIOR_DEVIATION: Final = 0.1
"""Standard deviation of the relative stiffness before a run [assumed: pressure, temperature]."""
FRICTION_DEVIATION: Final = 0.3
"""Standard deviation of the relative friction; plans on the rig show 0.15 to 0.25."""
BIAS_DEVIATION_A: Final = 0.05
"""Standard deviation of the constant current; a payload 3 mm off the axis causes 0.01 A."""
MOST: Final = 0.3
"""Bound on the magnitude of the relative stiffness that corrects the goals [assumed]."""


class StiffnessEstimate:
    """Recursive least squares of relative stiffness, friction and constant current."""

    def __init__(self, dof: int) -> None:
        self._dof = dof
        deviations = [PRIOR_DEVIATION, *[FRICTION_DEVIATION] * dof, *[BIAS_DEVIATION_A] * dof]
        self._theta = [0.0] * len(deviations)
        # Lists, because NumPy takes three times as long for five values.
        self._covariance = [
            [d * d if i == k else 0.0 for k in range(len(deviations))]
            for i, d in enumerate(deviations)
        ]
        self.value = 0.0

    def update(
        self, excess_a: Sequence[float], by_stiffness: Sequence[float],
        by_friction: Sequence[float], weight: Sequence[float],
    ) -> None:  # fmt: skip
        """Update with the currents of one fresh sample.

        `excess_a`: measured currents minus those of a link as stiff as the plant.
        """
        theta, covariance, dof = self._theta, self._covariance, self._dof
        for j in range(dof):
            w, innovation = weight[j], excess_a[j]
            if w <= 0.0 or not math.isfinite(innovation):
                continue
            a, b = by_stiffness[j], by_friction[j]  # regressors 0 and f; that of c is 1
            f, c = 1 + j, 1 + dof + j
            gain = [a * own[0] + b * own[f] + own[c] for own in covariance]
            variance = CURRENT_DEVIATION_A**2 + w * (a * gain[0] + b * gain[f] + gain[c])
            innovation -= a * theta[0] + b * theta[f] + theta[c]
            limit, share = 3.0 * math.sqrt(variance), w / variance
            step = share * min(max(innovation, -limit), limit)
            for i, g in enumerate(gain):
                theta[i] += step * g
                scaled = share * g
                covariance[i] = [p - scaled * h for p, h in zip(covariance[i], gain, strict=True)]
        self.value = min(max(theta[0], -MOST), MOST)
