"""Residual spectra of the twin over trials, and their exact derivatives by every fit parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from models.gap.residuals.fit_parameters import (
    FitParameter,
    moved_parameters,
    plant_with_every_effect,
)
from models.gap.residuals.spectrum import (
    Array,
    coefficient_count,
    cosine_transform,
    inverse_cosine_transform,
)
from models.gap.residuals.trial_runs import TrialRuns
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.fit import measured_signals, row_weights, shortened
from models.plant.plant import Plant
from models.plant.simulation.runner import trial_parameters
from models.plant.step_model import names
from models.trials.trial import Trial

_FOLLOWED: Final = "goal_{j}_rad angle_{j}_rad current_{j}_a"

LARGEST_DERIVATIVE: Final = 1e60
"""Largest derivative that counts: a simulation that diverges exceeds it, and its square would
overflow [assumed]."""


@dataclass(frozen=True)
class TrialGroup:
    """Trials of one motion, whose spectra can be compared coefficient by coefficient."""

    key: str  # See `trial_group_key`
    trials: tuple[int, ...]
    signals: tuple[str, ...]  # Signals that both simulation and measurement have
    coefficients: int  # Number of coefficients that are used


def trial_group_key(trial: Trial) -> str:
    """Key of a trial's conditions apart from payload and repetition."""
    m = trial.meta
    conditions = "".join(f" {name}={value:.5g}" for name, value in sorted(m.conditions.items()))
    return (
        f"{m.dof}dof {m.motion} {m.amplitude_rad:.5g}rad {m.period_s:.5g}s {m.phase_2_rad:.4g}rad "
        f"{len(trial)}x{trial.step_s:.5g}s{conditions}"
    )


def check_duration(trial: Trial, settings: GapSettings = DEFAULT_SETTINGS) -> None:
    """Refuse a trial that is too short to have a spectrum."""
    hz = settings.highest_frequency_hz
    least = settings.consistency_bands * settings.least_band_coefficients
    if coefficient_count(len(trial), trial.step_s, hz) < least:
        where = trial.path if trial.path.name else trial.name
        duration_s = len(trial) * trial.step_s
        raise InputError(
            where, f"lasts {duration_s:.2g} s", f"give at least {least / (2 * hz):.2g} s of motion"
        )


class Residuals:
    """Residual spectra of the twin with every effect, over trials."""

    def __init__(
        self,
        plant: Plant,
        trials: Sequence[Trial],
        fit_parameters: Sequence[FitParameter],
        settings: GapSettings = DEFAULT_SETTINGS,
    ) -> None:
        dofs = {t.meta.dof for t in trials}
        if len(dofs) != 1:
            raise InputError("trials", "are of one and of two joints", "choose one kind with --dof")
        model = plant_with_every_effect(plant).step_model(dofs.pop(), "twin")
        is_link = plant.load == "link"
        substep_s = settings.longest_substep_s if is_link else model.max_substep_s
        self.plant, self.trials = plant, shortened(trials, model, substep_s)
        self.fit_parameters, self.settings = tuple(fit_parameters), settings
        trials = self.trials
        self.model = replace(model, max_substep_s=substep_s)
        moved = [n for n in moved_parameters(fit_parameters) if n in names(model.parameters)]
        self._simulated = TrialRuns(self.model, moved, trials)
        self._outputs = names(model.outputs)
        self._base = [trial_parameters(model, t) for t in trials]
        self._low = np.array([v.minimum for v in model.parameters])
        self._high = np.array([v.maximum for v in model.parameters])
        self._set_directions(names(model.parameters), moved)
        self._measured = [measured_signals(t) for t in trials]
        self.groups = self._group()
        self._follows = [np.ones(len(t)) for t in trials]
        if is_link:
            self._follows = [
                rows_that_follow(t, error, settings)
                for t, error in zip(trials, self._usual_errors_rad(), strict=True)
            ]

    def _set_directions(self, known: Sequence[str], moved: Sequence[str]) -> None:
        """Matrices from the fit parameters to the model's parameters and outputs."""
        count = len(self.fit_parameters)
        self._by_parameter = np.zeros((len(known), count))
        self._by_output = np.zeros((len(self._outputs), count))
        for k, direction in enumerate(self.fit_parameters):
            for name, weight in direction.parameters.items():
                self._by_parameter[known.index(name), k] = weight
            for name, weight in direction.outputs.items():
                self._by_output[self._outputs.index(name), k] = weight
        self._moved = self._by_parameter[[known.index(n) for n in moved]]
        self._acts = np.array(
            [[q.trial in (None, i) for q in self.fit_parameters] for i in range(len(self.trials))]
        )

    def _group(self) -> list[TrialGroup]:
        found: dict[tuple[str, tuple[str, ...]], list[int]] = {}
        for k, trial in enumerate(self.trials):
            own = self._measured[k]
            seen = tuple(s for s in self._outputs if s in own and np.isfinite(own[s]).any())
            if not seen:
                raise InputError(
                    trial.path, "has no measured signal that the plant simulates",
                    "declare one of " + ", ".join(self._outputs) + " and give its samples",
                )  # fmt: skip
            found.setdefault((trial_group_key(trial), seen), []).append(k)
        result = []
        for (key, seen), rows in found.items():
            first = self.trials[rows[0]]
            count = coefficient_count(len(first), first.step_s, self.settings.highest_frequency_hz)
            check_duration(first, self.settings)
            result.append(TrialGroup(key, tuple(rows), seen, count))
        return result

    def residuals(self, values: Array) -> list[Array]:
        """Measured minus simulated, a spectrum (trials, signals, K) for each group."""
        runs = self._runs(values)
        return [self._spectra(g, runs) for g in self.groups]

    def jacobian(self, values: Array, wanted: NDArray[np.bool_]) -> list[Array]:
        """Derivatives of the simulated spectra, (trials, signals, K, wanted) for each group.

        Shapes: `values` (p,), `wanted` (p,).
        """
        group = {k: g for g in self.groups for k in g.trials}
        slopes = self._simulated.slopes(
            group,
            lambda k: self._parameters(k, values),
            np.asarray(self._moved[:, wanted].any(axis=1)),
            lambda k, own: self._slope_spectra(k, group[k], own, wanted),
        )
        return [np.stack([slopes[k] for k in g.trials]) for g in self.groups]

    def goal_not_followed(self) -> dict[str, int]:
        """First row that is not used, for each trial whose joint does not follow its goal."""
        return {
            t.name: int(rows.sum())
            for t, rows in zip(self.trials, self._follows, strict=True) if not rows.all()
        }  # fmt: skip

    def _usual_errors_rad(self) -> list[Array]:
        """Largest following error of each joint of the diagnosed plant's twin, rad, by trial."""
        runs, result = self._runs(np.zeros(len(self.fit_parameters))), []
        for k, trial in enumerate(self.trials):
            joints = range(1, trial.goal_rad.shape[1] + 1)
            angle = [self._outputs.index(f"angle_{j}_rad") for j in joints]
            result.append(np.abs(trial.goal_rad - runs[k][:, angle]).max(axis=0))
        return result

    def _parameters(self, k: int, values: Array) -> Array:
        p = self._base[k] + self._by_parameter @ (values * self._acts[k])
        return np.asarray(np.clip(p, self._low, self._high))

    def _runs(self, values: Array) -> dict[int, Array]:
        """Outputs (n, outputs) of the trials of all groups, by their indices."""
        which = sorted(k for g in self.groups for k in g.trials)
        runs = self._simulated.outputs(which, lambda k: self._parameters(k, values))
        return {k: y + self._by_output @ (values * self._acts[k]) for k, y in runs.items()}

    def _slope_spectra(
        self, k: int, group: TrialGroup, slopes: Array, wanted: NDArray[np.bool_]
    ) -> Array:
        """Spectra (signals, K, wanted) of a trial's derivatives (n, outputs, moved).

        A derivative that overflows counts as zero.
        """
        acting = wanted & self._acts[k]
        moved = self._moved[:, acting]
        used = moved.any(axis=1)
        spectra = np.zeros((len(group.signals), group.coefficients, int(wanted.sum())))
        for b, signal in enumerate(group.signals):
            o = self._outputs.index(signal)
            own = self._coefficients(k, signal, slopes[:, o, used], group.coefficients)
            level = self._coefficients(k, signal, np.ones(len(slopes)), group.coefficients)
            spectra[b][:, acting[wanted]] = own @ moved[used] + np.outer(
                level, self._by_output[o, acting]
            )
        spectra[~(np.abs(spectra) < LARGEST_DERIVATIVE)] = 0.0
        return spectra

    def _spectra(self, g: TrialGroup, runs: Mapping[int, Array]) -> Array:
        rows = np.empty((len(g.trials), len(g.signals), g.coefficients))
        for a, k in enumerate(g.trials):
            for b, signal in enumerate(g.signals):
                simulated = runs[k][:, self._outputs.index(signal)]
                residual = self._measured[k][signal] - simulated
                if np.isfinite(simulated).all():
                    residual = interpolate_missing(residual)
                rows[a, b] = self._coefficients(k, signal, residual, g.coefficients)
        return rows

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

    def _coefficients(self, k: int, signal: str, rows: Array, count: int) -> Array:
        weight = self._follows[k] * row_weights(self.trials[k], signal)
        return cosine_transform(weight.reshape(-1, *[1] * (rows.ndim - 1)) * rows, count)


def rows_that_follow(
    trial: Trial, usual_error_rad: Array, settings: GapSettings = DEFAULT_SETTINGS
) -> Array:
    """1 for each row before a joint stops following its goal, 0 after, shape (n,).

    There the current saturates and the joint falls behind. Two such falls differ, so no simulation
    reproduces them. Where angle or current were not measured, every row counts.

    Shapes: `usual_error_rad` (joints,).
    """
    joints = range(1, trial.meta.dof + 1)
    if any(q not in trial.columns for j in joints for q in _FOLLOWED.format(j=j).split()):
        return np.ones(len(trial))
    error, current = np.abs(trial.goal_rad - trial.angle_rad), np.abs(trial.current_a)
    behind = error > usual_error_rad + settings.not_followed_error_rad
    saturated = current > settings.not_followed_current_fraction * current.max(axis=0)
    not_followed = np.any(behind & saturated, axis=1)
    return np.asarray(np.cumsum(not_followed) == 0, dtype=np.float64)


def interpolate_missing(rows: Array) -> Array:
    """Rows with missing values interpolated; zero if all are missing."""
    seen = np.isfinite(rows)
    if seen.all():
        return rows
    if not seen.any():
        return np.zeros(len(rows))
    place = np.arange(len(rows))
    return np.interp(place, place[seen], rows[seen])
