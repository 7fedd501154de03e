"""Variation between trials, and the priors of fit parameters.

By chance a fit parameter goes only so far: it costs ½ (θ_k / s_k)², with its standard deviation
s_k. A clock error common to all trials is no variation between them but a property of the set-up,
which the gap workflow fits as the nuisance `synchronisation`. So the mean of `SHARED` over the
trials costs as if it were known. Otherwise six clocks that are 8 ms late would cost little, and
would hide an offset of 18 ms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.plant.identification.evaluation import TIP
from models.plant.identification.residual_spectra import FitParameter
from models.plant.plant import Plant
from models.plant.step_model import Array
from models.trials.trial import Trial

VARIED_EFFECTS: Final = ("payload_offset", "sync_offset")
"""Effects whose strength varies between trials of a link."""

SHARED: Final = "sync_s"
"""Variation whose mean over the trials is none."""

KNOWN_FRACTION: Final = 0.01
"""Standard deviation of a mean that counts as known, over its standard deviation by chance
[assumed]: small enough to hold the mean, large enough to keep matrices regular."""

ECCENTRICITY_M: Final = 0.003  # of the payload: standard deviation between repetitions [assumed]


def trial_variation(plant: Plant, trials: Sequence[Trial]) -> list[FitParameter]:
    """Pressure, friction, payload, clock and frame of each trial; nothing for loads but the link.

    `plant` has `VARIED_EFFECTS`. The standard deviations are assumed.
    """
    if plant.load != "link":
        return []
    q = plant.parameters
    stiff = {n: p.value for n, p in q.items() if p.unit == "N.m/rad"}
    stiff["root_limit_moment_nm"] = q["root_limit_moment_nm"].value
    friction = {n: p.value for n, p in q.items() if "_friction_" in n}
    result = []
    for k, trial in enumerate(trials):
        length_m = trial.meta.link_length_m or q["link_length_m"].value
        offset = {"payload_offset_share": 1 / length_m}
        result += [
            FitParameter("pressure", "trial", stiff, {}, 0.01, trial=k),
            FitParameter("friction", "trial", friction, {}, 0.05, trial=k),
            FitParameter("eccentricity_m", "trial", offset, {}, ECCENTRICITY_M, trial=k),
            FitParameter(SHARED, "trial", {"sync_offset_s": 1.0}, {}, 0.002, trial=k),
            *(FitParameter("frame_m", "trial", {}, {axis: 1.0}, 0.0003, trial=k) for axis in TIP),
        ]
    return result


def prior_rows(fit_parameters: Sequence[FitParameter]) -> Array:
    """Rows R whose cost ½ |R θ|² is that of the priors, shape (rows, p); zero without a prior."""
    deviation = np.array([q.standard_deviation for q in fit_parameters])
    rows = np.diag(1 / deviation)
    is_shared = np.array([q.kind == "trial" and q.name == SHARED for q in fit_parameters])
    if is_shared.any():
        count = is_shared.sum()
        mean_deviation = KNOWN_FRACTION * deviation[is_shared][0] / np.sqrt(count)  # alike in all
        rows = np.vstack([rows, is_shared / count / mean_deviation])
    return rows
