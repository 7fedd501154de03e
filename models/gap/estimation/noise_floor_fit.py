"""Measure the noise floor of a plant on trials without a gap: those that it was identified on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import msgspec
import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.noise_floor import (
    NoiseFloor,
    flat_floor,
    floor_from_plain,
    floor_from_residuals,
    floor_to_plain,
)
from models.gap.residuals.fit_parameters import nuisance_fit_parameters, trial_fit_parameters
from models.gap.residuals.residuals import Residuals, trial_group_key
from models.plant.identification.simulation_fit import SCALE
from models.plant.plant import Plant
from models.plant.provenance import FloorRecord
from models.trials.trial import Trial

ROUNDS: Final = 3
"""Times that floor and trial variation are found in turn."""


def with_noise_floor(plant: Plant, trials: Sequence[Trial]) -> Plant:
    """Plant whose provenance also holds the noise floor of trials that hold no hidden effect.

    Noise is told from the plant's own error by repetitions; without any there is no floor. Trials
    of two joints get none yet: their sensitivities take minutes.
    """
    floors: dict[str, FloorRecord] = {}
    for dof in sorted({t.meta.dof for t in trials} & {1}):
        own = [t for t in trials if t.meta.dof == dof]
        conditions = {(trial_group_key(t), t.meta.payload_kg) for t in own}
        if len(conditions) < len(own):
            plain = floor_to_plain(measure_noise_floor(plant, own))
            floors[str(dof)] = msgspec.convert(plain, FloorRecord)
    return replace(plant, provenance=msgspec.structs.replace(plant.provenance, noise_floor=floors))


def measure_noise_floor(plant: Plant, trials: Sequence[Trial]) -> NoiseFloor:
    """Floor of trials of one number of joints; of the knobs only trial variation is fitted."""
    dof = trials[0].meta.dof
    knobs = nuisance_fit_parameters(plant, dof) + trial_fit_parameters(plant, trials)
    problem = Residuals(plant, trials, knobs)
    floor = guessed_noise_floor(problem)
    free = np.array([k.kind == "trial" for k in knobs])
    for _ in range(ROUNDS):
        point = fitted_point(problem, replace(floor, curves={}), free)
        floor = floor_from_residuals(problem.groups, problem.trials, point.rows)
    return floor


def guessed_noise_floor(problem: Residuals) -> NoiseFloor:
    """Floor before anything is known of the signals."""
    units = {v.name: v.unit for v in problem.model.outputs}
    signals = list(dict.fromkeys(s for g in problem.groups for s in g.signals))
    return flat_floor(signals, {s: SCALE[units[s]] for s in signals})


def fitted_point(problem: Residuals, floor: NoiseFloor, free: Any) -> FitPoint:
    """Fit of the free knobs against a floor."""
    estimator = GaussNewton(problem, floor)
    return estimator.fit(estimator.at(np.zeros(len(problem.knobs))), free)


def noise_floor_of(plant: Plant, dof: int) -> NoiseFloor | None:
    """Floor that the plant file carries for a number of joints."""
    record = plant.provenance.noise_floor.get(str(dof))
    return floor_from_plain(msgspec.to_builtins(record)) if record else None
