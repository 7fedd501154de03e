"""Change of the link since the plant was identified, as estimated by the nuisance fit.

The plant's own error is known on the link that it was identified on: the mean error is subtracted.
The remaining error grows with the change of stiffness and mass (docs/decisions.md, "Gap workflow").
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.gap.residuals.fit_parameters import FitParameter
from models.plant.identification.noise_floor import Array

LEAST_CHANGE: Final = 0.3
"""Least change that counts: the fit estimates it with an error of some per cent [assumed]. The d′
that an effect must reach on an unchanged link does not depend on it."""
LARGEST_CHANGE: Final = 1.0
"""Largest change that counts: that of the calibration. A hidden effect that stiffens or softens
looks like a large change of the link; without this limit it would raise the d′ that it needs."""

REFERENCE: Final = {"_stiffness_": 0.1, "link_mass_kg": 0.1}
"""Relative changes of the calibration's links, by a part of the parameter's name."""


def link_change(
    fit_parameters: Sequence[FitParameter], values: Array, same_link: bool = False
) -> float:
    """Root mean square of the changes, relative to those of the calibration's links.

    It is limited, and the least change where the link is known to be the same. Shapes: `values`
    (p,).
    """
    least, most = LEAST_CHANGE, LARGEST_CHANGE
    if same_link:
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
