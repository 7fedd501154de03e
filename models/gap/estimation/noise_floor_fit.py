"""Measurement of a plant's noise floor on trials without a gap: those it was identified on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from firmware_py.errors import InputError
from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.measured_floor import (
    flat_floor,
    floor_from_residuals,
    floor_of_residual,
)
from models.gap.estimation.model_discrepancy import ModelDiscrepancy, patterns_for
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.noise_floor_record import floor_from_record, floor_to_record
from models.gap.residuals.aligned_trials import aligned
from models.gap.residuals.fit_parameters import (
    FitParameter,
    nuisance_fit_parameters,
    trial_fit_parameters,
)
from models.gap.residuals.residuals import Residuals, trial_group_key
from models.gap.residuals.spectrum import Array
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.document import FloorRecord
from models.plant.identification.fit import usual_error
from models.plant.plant import Plant
from models.trials.trial import Trial, TrialSet


def with_noise_floor(
    plant: Plant, trials: Sequence[Trial], settings: GapSettings = DEFAULT_SETTINGS
) -> Plant:
    """Plant whose provenance also holds the noise floor of trials without any hidden effect.

    Repetitions separate noise from the plant's own error; without any there is no floor. Trials of
    one and of two joints have a floor each.
    """
    floors: dict[str, FloorRecord] = {}
    trials = aligned(TrialSet(tuple(trials)))
    for dof in sorted({t.meta.dof for t in trials}):
        own = [t for t in trials if t.meta.dof == dof]
        conditions = {(trial_group_key(t), t.meta.payload_kg) for t in own}
        if len(conditions) < len(own):
            floors[str(dof)] = floor_to_record(measure_noise_floor(plant, own, settings))
    return replace(plant, provenance=msgspec.structs.replace(plant.provenance, noise_floor=floors))


def measure_noise_floor(
    plant: Plant, trials: Sequence[Trial], settings: GapSettings = DEFAULT_SETTINGS
) -> NoiseFloor:
    """Floor of trials with one number of joints; only the variation between trials is fitted."""
    parameters = nuisance_and_variation(plant, trials, settings)
    residuals = Residuals(plant, trials, parameters, settings)
    floor = guessed_noise_floor(residuals)
    free = np.array([q.kind == "trial" for q in parameters])
    for _ in range(settings.noise_floor_rounds):
        point = fitted_point(residuals, replace(floor, curves={}), free)
        floor = floor_from_residuals(residuals.groups, residuals.trials, point.rows, settings)
    return floor


def nuisance_and_variation(
    plant: Plant, trials: Sequence[Trial], settings: GapSettings = DEFAULT_SETTINGS
) -> list[FitParameter]:
    """Fit parameters without any effect: nuisance, and the variation of each trial."""
    nuisance = nuisance_fit_parameters(plant, trials[0].meta.dof, settings)
    return nuisance + trial_fit_parameters(plant, trials, settings)


def floor_of_nuisance_fit(residuals: Residuals) -> NoiseFloor:
    """Floor where the plant file carries none: the spectrum of the nuisance fit's residual."""
    base = np.array([q.kind != "effect" for q in residuals.fit_parameters])
    settings = residuals.settings
    floor = guessed_noise_floor(residuals)
    for _ in range(settings.nuisance_floor_rounds):
        point = fitted_point(residuals, floor, base)
        floor = floor_of_residual(residuals.groups, residuals.trials, point.rows, settings)
    return floor


def guessed_noise_floor(residuals: Residuals) -> NoiseFloor:
    """Floor from the usual error of each signal, before any residual is known."""
    units = {v.name: v.unit for v in residuals.model.outputs}
    signals = list(dict.fromkeys(s for g in residuals.groups for s in g.signals))
    measured = {s: [t.columns[s] for t in residuals.trials if s in t.columns] for s in signals}
    scale = {s: usual_error(units[s], measured[s]) for s in signals}
    return flat_floor(signals, scale, residuals.settings)


def fitted_point(residuals: Residuals, floor: NoiseFloor, free: Array) -> FitPoint:
    """Fit of the free fit parameters against a floor, starting from the diagnosed plant.

    Shapes: `free` (p,).
    """
    estimator = GaussNewton(residuals, floor)
    return estimator.fit(estimator.start(), free)


def noise_floor_for(residuals: Residuals, patterns: Sequence[ModelDiscrepancy] = ()) -> NoiseFloor:
    """Floor of the plant file; signals that it lacks get the floor of the nuisance fit.

    `patterns`: of the plant's own error on such trials; the packaged ones are used for other
    motions.
    """
    known = noise_floor_of(residuals.plant, residuals.trials[0].meta.dof)
    if known is not None:
        keys = [g.key for g in residuals.groups]
        known = replace(known, patterns=patterns_for(residuals.plant, keys, patterns))
    signals = {s for g in residuals.groups for s in g.signals}
    if known is not None and signals <= known.noise.keys():
        return known
    fitted = floor_of_nuisance_fit(residuals)
    if known is None:
        return fitted
    return known.completed_by(fitted)


def noise_floor_of(plant: Plant, dof: int) -> NoiseFloor | None:
    """Floor that the plant file carries for a number of joints; None if it carries none."""
    record = plant.provenance.noise_floor.get(str(dof))
    if record is None:
        return None
    try:
        return floor_from_record(record)
    except ValueError as error:
        raise InputError(
            f"plant {plant.name!r}", f"provenance.noise_floor.{dof} is damaged ({error})",
            "identify the plant again",
        ) from None  # fmt: skip
