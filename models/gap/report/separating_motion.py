"""Motion that would separate a named effect from its look-alikes.

The menu's motions are simulated with the named effect, and the other is fitted to them: the motion
with the worst fit separates best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from firmware_py.config import UNWATCHED_RATE_RAD_S
from firmware_py.errors import InputError
from models.gap.decision.look_alikes import LookAlike
from models.gap.diagnosis import Diagnosis
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.fixed_motions import MENU, motion_like, planned_trial
from models.gap.residuals.residuals import Residuals
from models.plant.identification.noise_floor import Array
from models.plant.plant import Plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.trials.trial import Trial

NO_MOTION: Final = "none of the menu"
"""Recommendation for a plant that cannot run the menu."""


def separating_motion(
    found: Diagnosis, trials: Sequence[Trial], alike: Sequence[LookAlike]
) -> tuple[str, dict[str, float]]:
    """Motion of the menu that best tells a named effect from its look-alikes.

    Returns its name, and for every motion the least d′ from any look-alike. The menu is that of the
    link; motions faster than a servo without a bus watchdog allows are left out.
    """
    if found.fitted.load != "link":
        return NO_MOTION, {}
    heaviest = max(t.meta.payload_kg for t in trials)
    swapped = found.settings.swapped_payload_kg
    result = {}
    for label, kind in MENU.items():
        payload = heaviest
        if label == "payload swap":
            payload = swapped if heaviest <= swapped / 2 else 0.0
        rest = found.settings.menu_rest_samples
        try:
            motion = motion_like(trials[0].meta, kind)
        except InputError:  # the trials' amplitude or period is out of range for a motion
            return NO_MOTION, {}
        planned = planned_trial(trials[0], motion, payload, rest)
        if _largest_rate_rad_s(planned) > UNWATCHED_RATE_RAD_S:
            continue
        trial = _simulated(found.fitted, planned)
        result[label] = min(_separation(found, trial, other) for other in alike)
    return max(result, key=lambda label: result[label], default=NO_MOTION), result


def _largest_rate_rad_s(trial: Trial) -> float:
    """Largest rate of the goals of a planned trial."""
    return float(np.abs(np.diff(trial.goal_rad, axis=0)).max() / trial.step_s)


def _simulated(plant: Plant, trial: Trial) -> Trial:
    """Planned trial with the outputs of a simulated plant."""
    compiled = CompiledModel(plant.step_model(trial.meta.dof, "twin"))
    y = run_trial(compiled, trial)
    outputs: dict[str, Array] = {
        name: y[:, k] for k, name in enumerate(names(compiled.model.outputs))
    }
    return replace(trial, columns=trial.columns | outputs)


def _separation(found: Diagnosis, trial: Trial, other: LookAlike) -> float:
    """d′ that remains after another effect is fitted to a trial, to first order."""
    common = [k for k, q in enumerate(found.fit_parameters) if q.trial in (None, 0)]
    parameters = [found.fit_parameters[k] for k in common]
    residuals = Residuals(found.plant, [trial], parameters, found.settings)
    estimator = GaussNewton(residuals, replace(found.floor, curves={}))
    point = estimator.linearise(estimator.at(other.values[common]))
    others = [e for e in found.named if e not in other.effects]
    kept = {*others[: len(found.named) - len(other.effects)], *other.effects}
    free = np.array([q.kind != "effect" or q.effect in kept for q in parameters])
    _, predicted = estimator.step(point, free)
    return math.sqrt(max(2 * (point.cost - predicted), 0.0))
