"""Change of the link since the plant was identified, as the nuisance fit finds it.

The plant's own error is known on the link that it was identified on: the mean error is subtracted.
What is left grows with the change of stiffness and mass. Measured on 57 links of 19 drawn rigs
(`python -m bench.gap.calibrate`): the mean square left in floors is 1.0 without a change, and 1.7
where stiffness and mass changed by 10 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.gap.residuals.fit_parameters import FitParameter
from models.gap.residuals.spectrum import Array

REFERENCE: Final = {"_stiffness_": 0.1, "link_mass_kg": 0.1}
"""Relative changes, by a part of the parameter's name, of the links of the calibration."""

LEAST: Final = 0.3
"""Least change that counts: the fit finds it with an error of some per cent [assumed]."""

MOST: Final = 1.0
"""Largest that counts. A hidden effect can look like a change of the link: a stiffening one of 1.0
moved the stiffness by several times what any link of the calibration did."""


def link_change(fit_parameters: Sequence[FitParameter], values: Array) -> float:
    """Root mean square of the changes, relative to those of the calibration's links.

    Parameters
    ----------
    fit_parameters : sequence of FitParameter
        Of the residuals.
    values : ndarray, shape (p,)
        Their values after the nuisance fit.
    """
    changes = [
        value / reference
        for q, value in zip(fit_parameters, values, strict=True)
        for part, reference in REFERENCE.items()
        if q.kind == "nuisance" and part in q.name
    ]
    if not changes:
        return MOST
    return float(np.clip(np.sqrt(np.mean(np.square(changes))), LEAST, MOST))
