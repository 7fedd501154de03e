"""Residual spectra of a diagnosis: those of the twin with every effect of the catalogue."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from firmware_py.core.errors import InputError
from models.gap.residuals.fit_parameters import plant_with_every_effect
from models.plant.identification.residual_spectra import FitParameter, ResidualSpectra
from models.plant.identification.trial_spectra import (
    TrialGroup,
    cosine_transform,
    inverse_cosine_transform,
)
from models.plant.plant import Plant
from models.plant.step_model import Array
from models.trials.trial import Trial


class Residuals(ResidualSpectra):
    """Residual spectra of the twin with every effect; `plant` is the one that is diagnosed."""

    def __init__(
        self, plant: Plant, trials: Sequence[Trial], fit_parameters: Sequence[FitParameter]
    ) -> None:
        if len({t.meta.dof for t in trials}) != 1:
            raise InputError("trials", "are of one and of two joints", "choose one kind with --dof")
        super().__init__(plant_with_every_effect(plant), trials, fit_parameters)
        self.plant = plant

    def goal_not_followed(self) -> dict[str, int]:
        """First row that is not used, for each trial whose joint does not follow its goal."""
        return {
            t.name: int(rows.sum())
            for t, rows in zip(self.trials, self._follows, strict=True) if not rows.all()
        }  # fmt: skip

    def as_counted(self, g: TrialGroup, spectra: Array) -> Array:
        """Spectra (..., trials, signals, K) recomputed with the unused rows set to zero."""
        result = spectra.copy()
        for a, k in enumerate(g.trials):
            rows, trial = self._follows[k], self.trials[k]
            if not rows.all():
                curves = inverse_cosine_transform(
                    np.moveaxis(spectra[..., a, :, :], -1, 0), len(trial)
                )
                kept_rows = cosine_transform((rows * curves.T).T, g.coefficients)
                result[..., a, :, :] = np.moveaxis(kept_rows, 0, -1)
        return result
