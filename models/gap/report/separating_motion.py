"""Motion that would tell a named effect from its look-alikes.

Each fixed motion is simulated with the named effects, and the others are fitted to it: the motion
with the worst fit separates best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from firmware_py.config import UNWATCHED_RATE_RAD_S
from firmware_py.core.errors import InputError
from models.gap.diagnosis import Diagnosis
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.fixed_motions import (
    MENU,
    REST_SAMPLES,
    SWAPPED_PAYLOAD_KG,
    motion_like,
    planned_trial,
)
from models.gap.report.gap_json import SeparatingMotion
from models.gap.residuals.residuals import Residuals
from models.gap.search.effect_search import SetFit
from models.plant.plant import Plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.trials.trial import Trial

NO_MOTION: Final = "none of the menu"
"""Recommendation for a plant that cannot run the fixed motions."""


def separating_motion(diagnosis: Diagnosis, alike: Sequence[SetFit]) -> SeparatingMotion:
    """Fixed motion with the largest least d′ between the named effects and their look-alikes.

    The motions are those of the link; those faster than a servo without a bus watchdog allows are
    left out.
    """
    if diagnosis.fitted.load != "link":
        return SeparatingMotion(NO_MOTION, {})
    sizes = {
        label: round(min(_separations(diagnosis, _simulated(diagnosis.fitted, trial), alike)), 2)
        for label, trial in _planned_trials(diagnosis.trials).items()
    }
    return SeparatingMotion(max(sizes, key=lambda m: sizes[m], default=NO_MOTION), sizes)


def _planned_trials(trials: Sequence[Trial]) -> dict[str, Trial]:
    """Trials of the fixed motions that may be run, by their displayed name."""
    heaviest_kg = max(t.meta.payload_kg for t in trials)
    swapped_kg = SWAPPED_PAYLOAD_KG if heaviest_kg <= SWAPPED_PAYLOAD_KG / 2 else 0.0
    planned = {}
    for label, kind in MENU.items():
        payload_kg = swapped_kg if label == "payload swap" else heaviest_kg
        try:
            motion = motion_like(trials[0].meta, kind)
        except InputError:  # the trials' amplitude or period is out of range for a motion
            return {}
        trial = planned_trial(trials[0], motion, payload_kg, REST_SAMPLES)
        rate_rad_s = np.abs(np.diff(trial.goal_rad, axis=0)).max() / trial.step_s
        if rate_rad_s <= UNWATCHED_RATE_RAD_S:
            planned[label] = trial
    return planned


def _simulated(plant: Plant, trial: Trial) -> Trial:
    """Planned trial with the outputs of a simulated plant."""
    compiled = CompiledModel(plant.step_model(trial.meta.dof, "twin"))
    y = run_trial(compiled, trial)
    outputs = {name: y[:, k] for k, name in enumerate(names(compiled.model.outputs))}
    return replace(trial, columns=trial.columns | outputs)


def _separations(diagnosis: Diagnosis, trial: Trial, alike: Sequence[SetFit]) -> list[float]:
    """d′ that remains after each look-alike is fitted to a trial, to first order."""
    fit_parameters = diagnosis.nuisance.estimator.residuals.fit_parameters
    common = [k for k, q in enumerate(fit_parameters) if q.trial in (None, 0)]
    residuals = Residuals(diagnosis.plant, [trial], [fit_parameters[k] for k in common])
    estimator = GaussNewton(residuals, replace(diagnosis.floor, curves={}))
    result = []
    for other in alike:
        free = other.free[common]
        point = estimator.linearise(estimator.at(other.point.values[common]), free)
        _, predicted = estimator.step(point, free)
        result.append(math.sqrt(max(2 * (point.cost - predicted), 0.0)))
    return result
