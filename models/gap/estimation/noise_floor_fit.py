"""Noise floor of a diagnosis: that of the plant file, completed by that of the nuisance fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from firmware_py.errors import InputError
from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.measured_floor import floor_of_residual
from models.gap.estimation.model_discrepancy import ModelDiscrepancy, patterns_for
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.residuals.fit_parameters import (
    FitParameter,
    nuisance_fit_parameters,
    trial_fit_parameters,
)
from models.gap.residuals.residuals import Residuals
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.noise_floor import Array, floor_from_record, guessed_floor
from models.plant.plant import Plant
from models.trials.trial import Trial


def nuisance_and_variation(
    plant: Plant, trials: Sequence[Trial], settings: GapSettings = DEFAULT_SETTINGS
) -> list[FitParameter]:
    """Fit parameters without any effect: nuisance, and the variation of each trial."""
    nuisance = nuisance_fit_parameters(plant, trials[0].meta.dof, settings)
    return nuisance + trial_fit_parameters(plant, trials)


def floor_of_nuisance_fit(residuals: Residuals) -> NoiseFloor:
    """Floor where the plant file carries none: the spectrum of the nuisance fit's residual."""
    base = np.array([q.kind != "effect" for q in residuals.fit_parameters])
    floor = guessed_noise_floor(residuals)
    for _ in range(residuals.settings.nuisance_floor_rounds):
        point = fitted_point(residuals, floor, base)
        floor = floor_of_residual(residuals.groups, residuals.trials, point.rows)
    return floor


def guessed_noise_floor(residuals: Residuals) -> NoiseFloor:
    """Floor from the usual error of each signal, before any residual is known."""
    units = {v.name: v.unit for v in residuals.model.outputs}
    guessed = guessed_floor(residuals.groups, residuals.trials, units)
    return NoiseFloor.of(guessed, learned=False)


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
        return NoiseFloor.of(floor_from_record(record))
    except ValueError as error:
        raise InputError(
            f"plant {plant.name!r}", f"provenance.noise_floor.{dof} is damaged ({error})",
            "identify the plant again",
        ) from None  # fmt: skip
