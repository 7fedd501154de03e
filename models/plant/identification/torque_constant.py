"""Check of the torque constant: whether the declared payloads fit another value better.

The plant takes the torque per ampere from the servo's data sheet. If it is wrong, masses, inertia
and friction are wrong by the same factor. But the payloads are known, so the difference in current
between two payloads does not match their weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from models.plant.identification.identification import (
    DRIVEN_SUBSTEP_S,
    LINK_SIGNALS,
    free_parameters,
)
from models.plant.identification.simulation_fit import Objective
from models.plant.plant import Plant
from models.trials.trial import Trial

DIFFERENT_FRACTION: Final = 0.1
"""Relative difference of the constant above which the user is warned [assumed: one servo's constant
is within some per cent of its model's; on rigs with the right value the fit was within 2 %]."""

SURE_DEVIATIONS: Final = 5.0
"""The same in standard deviations [assumed: model errors are larger than noise]."""

LEAST_INVERSE: Final = 0.1
"""Ratio of measured to expected growth of the current with the payload below which no constant
explains it [assumed: a servo with ten times the torque per ampere is another servo]."""


def torque_constant_doubts(plant: Plant, trials: Sequence[Trial]) -> list[str]:
    """Warnings, one per joint whose torque constant seems wrong, by one step of a fit."""
    planes = max(t.meta.dof for t in trials)
    declared = [f"torque_constant_{j}_nm_a" for j in range(1, planes + 1)]
    known = plant.parameters
    constants = [n for n in declared if n in known and known[n].role == "fixed"]
    if plant.load != "link" or not constants or len({t.meta.payload_kg for t in trials}) < 2:
        return []
    free = (*free_parameters(plant, planes)[0], *constants)
    rms = plant.provenance.residual_rms
    objective = Objective(plant, "driven", trials, free, LINK_SIGNALS, rms, DRIVEN_SUBSTEP_S, plant)
    residual, slopes = objective(objective.start)
    information = slopes.T @ slopes
    step = -np.linalg.solve(information, slopes.T @ residual)
    deviation = np.sqrt(np.diag(np.linalg.inv(information)))
    said = []
    for name in constants:
        k, value = free.index(name), known[name].value
        if abs(step[k]) > max(DIFFERENT_FRACTION * value, SURE_DEVIATIONS * deviation[k]):
            inverse = 1 - step[k] / value  # the current is linear in the constant's inverse
            if inverse < LEAST_INVERSE:
                said.append(
                    f"the current of joint {name.split('_')[2]} does not grow with the payload as "
                    "its weight does: check the sign and the unit of the current, and the declared "
                    "payloads"
                )
                continue
            better = value / inverse
            said.append(
                f"the payloads speak for {name} of about {better:.2g} N.m/A, not "
                f"{value:.3g}: give that of your servo in link.toml, or fit it (role = "
                '"nuisance" in the file given to --plant)'
            )
    return said
