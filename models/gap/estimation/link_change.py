"""Change of the link since the plant was identified, as estimated by the nuisance fit.

The plant's own error is known on the link that it was identified on: the mean error is subtracted.
The remaining error grows with the change of stiffness and mass (docs/decisions.md, "Gap workflow").
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.gap.residuals.fit_parameters import FitParameter
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.noise_floor import Array

REFERENCE: Final = {"_stiffness_": 0.1, "link_mass_kg": 0.1}
"""Relative changes of the calibration's links, by a part of the parameter's name."""


def link_change(
    fit_parameters: Sequence[FitParameter], values: Array, settings: GapSettings = DEFAULT_SETTINGS
) -> float:
    """Root mean square of the changes, relative to those of the calibration's links.

    It is limited to the least and largest change of the settings, and the least one where the link
    is the same. Shapes: `values` (p,).
    """
    least, most = settings.least_link_change, settings.largest_link_change
    if settings.same_link:
        return least
    changes = [
        value / reference
        for q, value in zip(fit_parameters, values, strict=True)
        for part, reference in REFERENCE.items()
        if q.kind == "nuisance" and part in q.name
    ]
    if not changes:
        return most
    return float(np.clip(np.sqrt(np.mean(np.square(changes))), least, most))
