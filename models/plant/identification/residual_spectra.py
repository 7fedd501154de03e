"""Residual spectra of a twin over trials, and their exact derivatives by every fit parameter.

Fit parameters are linear in the plant's parameters, p = p_0 + Σ w θ, so one run with exact
sensitivities serves all of them. Many trials are simulated by one compiled model, on two threads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from models.plant.identification.fit import (
    LARGEST_DERIVATIVE,
    WORKERS,
    measured_signals,
    row_weights,
    shortened,
)
from models.plant.identification.trial_spectra import TrialGroup, cosine_transform, trial_groups
from models.plant.plant import Plant
from models.plant.simulation.runner import (
    CompiledModel,
    differentiate_trial,
    run_trial,
    trial_parameters,
)
from models.plant.step_model import Array, names
from models.trials.trial import Trial

LONGEST_SUBSTEP_S: Final = 2.9e-3
"""Longest internal step of the link's simulation: what a dead time of zero allows
(`models.plant.effects.command`). Measured: six a period are within 5 µm and 0.5 mA of a step of
0.25 ms; 46 µm with ten times the usual friction. Other loads keep the step of their model: the
bristles of a small gear are faster."""

Kind = Literal["nuisance", "trial", "effect"]
"""Of a fit parameter: `nuisance` holds for all trials and never counts as missing; `trial` varies
from trial to trial with a known standard deviation, and so belongs to the noise floor; `effect` is
searched for."""


@dataclass(frozen=True)
class FitParameter:
    """One direction of a fit in the parameters and outputs of the twin; zero changes nothing."""

    name: str  # Name of the parameter of the plant, or of the variation
    kind: Kind
    # Change of each plant parameter per unit; a twin of fewer joints may lack some
    parameters: Mapping[str, float] = field(default_factory=dict)
    # Direct change of each output per unit
    outputs: Mapping[str, float] = field(default_factory=dict)
    standard_deviation: float = math.inf  # Of the prior around zero; infinite without a prior
    low: float = -math.inf
    high: float = math.inf
    trial: int | None = None  # Index of the only trial that it acts on
    effect: str = ""  # Candidate that it belongs to: EFFECT, or EFFECT:JOINT; empty if none
    fitted_last: bool = False

    @property
    def is_strength(self) -> bool:
        """Whether it is a strength of its effect: only these have no prior."""
        return bool(self.effect) and math.isinf(self.standard_deviation)


class ResidualSpectra:
    """Residual spectra of a plant over trials with one number of joints.

    The plant has the effects whose parameters the fit parameters move.
    """

    def __init__(
        self, plant: Plant, trials: Sequence[Trial], fit_parameters: Sequence[FitParameter]
    ) -> None:
        is_link = plant.load == "link"
        model = plant.step_model(trials[0].meta.dof, "twin")
        if is_link:
            model = model.with_substeps(LONGEST_SUBSTEP_S)
        self.plant, self.model = plant, model
        self.trials = trials = shortened(trials, model)
        self.fit_parameters = tuple(fit_parameters)
        self._base = [trial_parameters(model, t) for t in trials]
        self._low = np.array([v.minimum for v in model.parameters])
        self._high = np.array([v.maximum for v in model.parameters])
        self._outputs = names(model.outputs)
        # Change of the parameters and of the outputs by each fit parameter, and where it acts
        parameters = names(model.parameters)
        self._by_parameter: Array = np.array(
            [[q.parameters.get(name, 0.0) for q in fit_parameters] for name in parameters]
        )
        self._by_output: Array = np.array(
            [[q.outputs.get(name, 0.0) for q in fit_parameters] for name in self._outputs]
        )
        self._acts = np.array(
            [[q.trial in (None, k) for q in fit_parameters] for k in range(len(trials))]
        )
        in_order = dict.fromkeys(name for q in fit_parameters for name in q.parameters)
        moved = [name for name in in_order if name in parameters]
        self._by_moved = self._by_parameter[[parameters.index(name) for name in moved]]
        self._pool = ThreadPoolExecutor(WORKERS)
        self._plain, self._sensitive = self._pool.map(
            lambda wrt: CompiledModel(model, wrt), ((), moved)
        )
        self._measured = [measured_signals(t) for t in trials]
        self.groups = trial_groups(trials, self._outputs)
        self._follows = [np.ones(len(t)) for t in trials]
        if is_link:
            angles = [self._outputs.index(f"angle_{j + 1}_rad") for j in range(trials[0].meta.dof)]
            for k, y in self._runs(np.zeros(len(fit_parameters))).items():
                usual_error_rad = np.abs(trials[k].goal_rad - y[:, angles]).max(axis=0)
                self._follows[k] = rows_that_follow(trials[k], usual_error_rad)

    def residuals(self, values: Array) -> list[Array]:
        """Measured minus simulated, a spectrum (trials, signals, K) for each group."""
        runs = self._runs(values)
        return [self._spectra(g, runs) for g in self.groups]

    def jacobian(self, values: Array, wanted: NDArray[np.bool_]) -> list[Array]:
        """Derivatives of the simulated spectra, (trials, signals, K, wanted) for each group.

        Shapes: `values` (p,), `wanted` (p,).
        """
        group = {k: g for g in self.groups for k in g.trials}
        moved = np.asarray(self._by_moved[:, wanted].any(axis=1))

        def slopes(k: int) -> Array:
            p = self._parameters(k, values)
            _, derivatives = differentiate_trial(self._sensitive, self.trials[k], p, moved)
            return self._slope_spectra(k, group[k], derivatives, wanted)

        by_trial = self._of_each_trial(slopes)
        return [np.stack([by_trial[k] for k in g.trials]) for g in self.groups]

    def instability(self, rows: Sequence[Array]) -> InputError:
        """Error that names the trials on which the plant does not stay finite.

        Shapes: `rows` (trials, signals, K), residual spectra.
        """
        unstable = [
            str(self.trials[k].path)
            for g, spectra in zip(self.groups, rows, strict=True)
            for k, spectrum in zip(g.trials, spectra, strict=True)
            if not float(np.sum(spectrum**2)) < np.inf
        ]
        return InputError(
            f"plant {self.plant.name!r}",
            "does not stay finite on " + (", ".join(unstable) or "these trials"),
            "identify it on trials of this robot, or check the conditions of the trials",
        )

    def _parameters(self, k: int, values: Array) -> Array:
        p = self._base[k] + self._by_parameter @ (values * self._acts[k])
        return np.asarray(np.clip(p, self._low, self._high))

    def _runs(self, values: Array) -> dict[int, Array]:
        """Outputs (n, outputs) of the trials of all groups, by their indices."""

        def run(k: int) -> Array:
            y = run_trial(self._plain, self.trials[k], self._parameters(k, values))
            return np.asarray(y + self._by_output @ (values * self._acts[k]))

        return self._of_each_trial(run)

    def _of_each_trial(self, run: Callable[[int], Array]) -> dict[int, Array]:
        """Results of `run` for the trials of all groups, by their indices."""
        indices = [k for g in self.groups for k in g.trials]
        longest_first = sorted(indices, key=lambda k: -len(self.trials[k]))
        return dict(zip(longest_first, self._pool.map(run, longest_first), strict=True))

    def _spectra(self, g: TrialGroup, runs: Mapping[int, Array]) -> Array:
        rows = np.empty((len(g.trials), len(g.signals), g.coefficients))
        for a, k in enumerate(g.trials):
            for b, signal in enumerate(g.signals):
                simulated = runs[k][:, self._outputs.index(signal)]
                residual = self._measured[k][signal] - simulated
                if np.isfinite(simulated).all():
                    residual = _interpolated(residual)
                rows[a, b] = self._coefficients(k, signal, residual, g.coefficients)
        return rows

    def _slope_spectra(
        self, k: int, group: TrialGroup, slopes: Array, wanted: NDArray[np.bool_]
    ) -> Array:
        """Spectra (signals, K, wanted) of a trial's derivatives (n, outputs, moved).

        A derivative that overflows counts as zero.
        """
        acting = wanted & self._acts[k]
        moved = self._by_moved[:, acting]
        used = moved.any(axis=1)
        spectra = np.zeros((len(group.signals), group.coefficients, int(wanted.sum())))
        for b, signal in enumerate(group.signals):
            o = self._outputs.index(signal)
            with np.errstate(over="ignore", invalid="ignore"):  # an unstable simulation
                rows = slopes[:, o, used] @ moved[used] + self._by_output[o, acting]
                coefficients = self._coefficients(k, signal, rows, group.coefficients)
            spectra[b][:, acting[wanted]] = coefficients
        spectra[~(np.abs(spectra) < LARGEST_DERIVATIVE)] = 0.0
        return spectra

    def _coefficients(self, k: int, signal: str, rows: Array, count: int) -> Array:
        """Spectrum (K, ...) of rows (n, ...) of a signal, weighted as in a fit."""
        weight = self._follows[k] * row_weights(self.trials[k], signal)
        return cosine_transform((weight * rows.T).T, count)


NOT_FOLLOWED_RAD: Final = 0.03
"""Following error, beyond the largest of the twin, above which a goal counts as not followed
[assumed]."""


def rows_that_follow(trial: Trial, usual_error_rad: Array) -> Array:
    """1 for each row before a joint stops following its goal, 0 after, shape (n,).

    There the current saturates and the joint falls behind. Two such falls differ, so no simulation
    reproduces them. Where angle or current were not measured, every row counts. `usual_error_rad`
    has shape (joints,).
    """
    joints = range(1, trial.meta.dof + 1)
    needed = {q.format(j) for q in ("goal_{}_rad", "angle_{}_rad", "current_{}_a") for j in joints}
    if not trial.columns.keys() >= needed:
        return np.ones(len(trial))
    error, current = np.abs(trial.goal_rad - trial.angle_rad), np.abs(trial.current_a)
    behind = error > usual_error_rad + NOT_FOLLOWED_RAD
    saturated = current > 0.95 * current.max(axis=0)  # [assumed]
    not_followed = np.any(behind & saturated, axis=1)
    return np.asarray(np.cumsum(not_followed) == 0, dtype=np.float64)


def _interpolated(rows: Array) -> Array:
    """Rows with missing values interpolated; zero if all are missing."""
    measured = np.isfinite(rows)
    if not measured.any():
        return np.zeros(len(rows))
    place = np.arange(len(rows))
    return np.interp(place, place[measured], rows[measured])
