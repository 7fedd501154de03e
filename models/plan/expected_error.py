"""Expected error of a plan that has learned, from the uncertainty that recorded runs leave.

Over payloads the plant's error is a Gaussian process with the correlation by which changes of the
goals are spread (Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2006, equation
2.26). Its posterior error and the scatter between runs are independent. Runs whose tip comes from
the observer do not reduce the plant's error: the observer has it too.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.goals.tip_plan import TipPlan
from models.plan.recorded_plan_run import RecordedRun

Array = NDArray[np.float64]
PAYLOAD_REACH_KG: Final = 1.0
"""Distance in payload over which a change fades: correlation length of the learned
goals [assumed]."""
SCATTER: Final = 0.25
"""RMS difference of two runs of a plan over the plant's error. Measured on the rig, circle of 6 s
with 1.8 kg: runs differ by a quarter."""
UNTOLD: Final = 1e-3
"""Part of the plant's squared error that remains at the payload of a run [assumed]: without it
several runs at one payload make the equations singular."""


def payload_correlation(a_kg: ArrayLike, b_kg: ArrayLike) -> Array:
    """Correlation of goals and of the plant's error between payloads, shape (a, b)."""
    apart = np.subtract.outer(np.asarray(a_kg), np.asarray(b_kg)) / PAYLOAD_REACH_KG
    return np.asarray(np.exp(-0.5 * apart**2))


def unknown_error_m(plan: TipPlan, run: RecordedRun, payloads_kg: ArrayLike) -> Array:
    """RMS error at payloads that neither the twin nor the recorded runs predict, shape (p,).

    Shapes: `payloads_kg` (p,).
    """
    off_m = float(np.sqrt(np.mean(np.sum((run.tip_m - plan.desired_tip_m()) ** 2, axis=1))))
    plant_m = plan.plant_error_rms_m or 0.0
    scatter_m = SCATTER * (plant_m or off_m)
    seen = [known.payload_kg for known in plan.learned if known.source == "mocap"]
    if run.source == "mocap":
        seen.append(run.payload_kg)
    at = np.asarray(payloads_kg, dtype=np.float64)
    left = np.ones(len(at))
    if seen:
        own = payload_correlation(seen, seen) + UNTOLD * np.eye(len(seen))
        across = payload_correlation(at, seen)
        left -= np.sum(across * np.linalg.solve(own, across.T).T, axis=1)
    return np.hypot(plant_m * np.sqrt(np.maximum(left, 0.0)), scatter_m)
