"""Measure the noise floor of a plant on trials without a gap: those that it was identified on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import msgspec
import numpy as np

from models.gap.estimation.gauss_newton import GaussNewton, Point
from models.gap.estimation.noise_floor import NoiseFloor, first_guess, learn, read, write
from models.gap.residuals.fit_parameters import nuisance_knobs, trial_knobs
from models.gap.residuals.residuals import Residuals, group_key
from models.plant.identification.simulation_fit import SCALE
from models.plant.plant import Plant
from models.plant.provenance import FloorRecord
from models.trials.trial import Trial

ROUNDS: Final = 3
"""Times that floor and trial variation are found in turn."""


def with_floor(plant: Plant, trials: Sequence[Trial]) -> Plant:
    """Plant whose provenance also holds the noise floor of trials that hold no hidden effect.

    Noise is told from the plant's own error by repetitions; without any there is no floor. Trials
    of two joints get none yet: their sensitivities take minutes.
    """
    floors: dict[str, FloorRecord] = {}
    for dof in sorted({t.meta.dof for t in trials} & {1}):
        own = [t for t in trials if t.meta.dof == dof]
        conditions = {(group_key(t), t.meta.payload_kg) for t in own}
        if len(conditions) < len(own):
            floors[str(dof)] = msgspec.convert(write(learn_floor(plant, own)), FloorRecord)
    return replace(plant, provenance=msgspec.structs.replace(plant.provenance, noise_floor=floors))


def learn_floor(plant: Plant, trials: Sequence[Trial]) -> NoiseFloor:
    """Floor of trials of one number of joints; of the knobs only trial variation is fitted."""
    dof = trials[0].meta.dof
    knobs = nuisance_knobs(plant, dof) + trial_knobs(plant, trials)
    problem = Residuals(plant, trials, knobs)
    floor = guess(problem)
    free = np.array([k.kind == "trial" for k in knobs])
    for _ in range(ROUNDS):
        point = fitted(problem, replace(floor, curves={}), free)
        floor = learn(problem.groups, problem.trials, point.rows)
    return floor


def guess(problem: Residuals) -> NoiseFloor:
    """Floor before anything is known of the signals."""
    units = {v.name: v.unit for v in problem.model.outputs}
    signals = list(dict.fromkeys(s for g in problem.groups for s in g.signals))
    return first_guess(signals, {s: SCALE[units[s]] for s in signals})


def fitted(problem: Residuals, floor: NoiseFloor, free: Any) -> Point:
    """Fit of the free knobs against a floor."""
    estimator = GaussNewton(problem, floor)
    return estimator.fit(estimator.at(np.zeros(len(problem.knobs))), free)


def floor_of(plant: Plant, dof: int) -> NoiseFloor | None:
    """Floor that the plant file carries for a number of joints."""
    record = plant.provenance.noise_floor.get(str(dof))
    return read(msgspec.to_builtins(record)) if record else None
