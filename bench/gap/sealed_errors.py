"""Errors of plants on sealed trials: of another motion and another payload, never fitted to.

The same trials without the hidden effects tell what the plant as given reaches where nothing is
missing. Its own error may make up for a hidden effect in one signal: a plant with that effect,
however right, then errs more there.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from bench.gap.cases import BenchCase
from bench.gap.rig_plants import required_noise_floor
from firmware_py.errors import InputError
from firmware_py.motion import Kind, Motion
from models.plant.identification.evaluation import compare_with_trials
from models.plant.plant import Plant
from models.rig.rig_parameters import RigParameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial import Trial

SEALED_CONDITIONS: Final[dict[str, tuple[Kind, float]]] = {
    "motion": ("multisine", 1.0), "payload": ("sinusoid", 1.5),
}  # fmt: skip
"""Motion and payload of the sealed trials."""


class SealedErrors:
    """Sealed trials of a case, with the hidden effects and without them."""

    def __init__(self, rig: RigParameters, case: BenchCase) -> None:
        hidden = rig.hide(case.added_to_rig)
        self.trials: dict[str, tuple[Trial, Trial | None]] = {}
        for what, (kind, payload_kg) in SEALED_CONDITIONS.items():
            motion = Motion(kind, dof=case.joints)
            conditions = TrialCase(motion, payload_kg, 3, case.seed)
            if (trial := _recorded(hidden, conditions)) is not None:
                self.trials[what] = trial, _recorded(rig, conditions)

    def in_noise_floors(self, given: Plant, improved: Plant) -> list[float] | None:
        """Errors on another motion, in noise floors."""
        trial, plain = self.trials.get("motion", (None, None))
        if trial is None or plain is None:
            return None
        return [_error(given, trial), _error(improved, trial), _error(given, plain)]

    def rms(self, given: Plant, improved: Plant) -> dict[str, dict[str, list[float]]]:
        """Root mean square errors in SI units: trial → signal → those of `in_noise_floors`.

        The third is missing where no trial without the effects is there.
        """
        result: dict[str, dict[str, list[float]]] = {}
        for what, (trial, plain) in self.trials.items():
            rows = [_rms(given, trial), _rms(improved, trial)]
            rows += [_rms(given, plain)] if plain is not None else []
            result[what] = {s: [row[s] for row in rows] for s in rows[0]}
        return result


def _recorded(rig: RigParameters, conditions: TrialCase) -> Trial | None:
    try:
        return run_case(rig, conditions)
    except InputError:  # the link folds
        return None


def _error(plant: Plant, trial: Trial) -> float:
    """Root mean square over signals, each in its own noise floor."""
    floor = required_noise_floor(plant, trial.meta.dof)
    squares = [
        rms**2 / np.mean(floor.noise[s] + floor.model[s])
        for s, rms in _rms(plant, trial).items()
        if s in floor.noise
    ]
    return float(np.sqrt(np.mean(squares)))


def _rms(plant: Plant, trial: Trial) -> dict[str, float]:
    """Root mean square error of each signal in its SI unit."""
    comparison = compare_with_trials(plant, [trial])[0]
    return {s: float(np.sqrt(np.nanmean(comparison.error(s) ** 2))) for s in comparison.simulated}
