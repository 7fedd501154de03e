"""Twin with the stiffness and damping of the link estimated from a recorded run.

Learning multiplies errors by the inverse of the twin. At the first mode that inverse is right only
if the twin has the mode at the frequency of the link: with a link that is a fifth stiffer than its
plant, errors there did not fall from run to run. So the relative stiffness k and damping c of the
twin are fitted to the recorded tip y::

    sum |y - tip(k, c) - offset|^2 / NOISE^2 + (log k / STIFFNESS_SD)^2 + (log c / DAMPING_SD)^2

by Gauss–Newton. The offset of the recording is free. The priors keep k and c near 1 if a run does
not determine them.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.plan.feedback.linear_twin import STIFFNESS
from models.plan.twin_sensitivity import TipTwin
from models.plant.plant import Plant

Array = NDArray[np.float64]
DAMPING: Final = ("root_damping", "span_damping")
"""Prefixes of the parameters that scale with the damping of the link."""
STIFFNESS_SD: Final = 0.2
DAMPING_SD: Final = 0.5
"""Standard deviations of the logarithms of both factors [assumed]."""
NOISE_M: Final = 2e-3
"""Standard deviation of the tip about the fitted twin: the error of the demo's plant on trials that
it was not fitted to."""
CORRELATED_S: Final = 0.5
"""Time over which that error counts once: about a period of the first mode."""
STEPS: Final = 6
DIFFERENCE: Final = 0.02
"""Most steps, and the difference of a logarithm over which slopes are taken [assumed]."""


def recorded_twin(
    twin: TipTwin, plant: Plant, goals_rad: Array, tip_m: Array, payload_kg: float
) -> tuple[TipTwin, float, float]:
    """Fit stiffness and damping of the link; return the twin and both factors.

    Shapes: `goals_rad` (n, dof), `tip_m` (n, dof).
    """
    sd = np.array([STIFFNESS_SD, DAMPING_SD])
    weight = np.sqrt(twin.period_s / CORRELATED_S) / NOISE_M

    def changed(logs: Array) -> TipTwin:
        factors = np.exp(logs)
        return twin.changed({
            name: own.value * factors[k]
            for k, begins in enumerate((STIFFNESS, DAMPING))
            for name, own in plant.parameters.items()
            if name.startswith(begins)
        })  # fmt: skip

    def off(logs: Array) -> Array:
        own = changed(logs)
        error = tip_m - own.tip_m(own.run(goals_rad, payload_kg))
        return np.concatenate([weight * (error - error.mean(axis=0)).ravel(), logs / sd])

    logs, now = np.zeros(2), off(np.zeros(2))
    for _ in range(STEPS):
        slopes = np.column_stack(
            [(off(logs + d) - now) / DIFFERENCE for d in DIFFERENCE * np.eye(2)]
        )
        step = np.clip(-np.linalg.lstsq(slopes, now, rcond=None)[0], -sd, sd)
        tried = off(logs + step)
        if not tried @ tried < now @ now:
            break
        logs, now = logs + step, tried
    stiffness, damping = (float(f) for f in np.exp(logs))
    return changed(logs), stiffness, damping
