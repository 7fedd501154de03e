"""Residual spectra of the twin over trials, and their exact derivatives by every fit parameter.

Many trials are simulated by one compiled model, on two threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from models.gap.residuals.fit_parameters import (
    FitParameter,
    moved_parameters,
    plant_with_every_effect,
)
from models.plant.identification.fit import LARGEST_DERIVATIVE, measured_signals, shortened
from models.plant.identification.noise_floor import (
    LONGEST_SUBSTEP_S,
    Array,
    TrialGroup,
    cosine_transform,
    interpolate_missing,
    inverse_cosine_transform,
    rows_that_follow,
    signal_spectrum,
    trial_groups,
)
from models.plant.plant import Plant
from models.plant.simulation.runner import CompiledModel, trial_inputs, trial_parameters
from models.plant.step_model import StepModel, names
from models.trials.trial import Trial

WORKERS: Final = 2
"""Threads that compile and simulate; ctypes releases the interpreter lock meanwhile."""

Result = TypeVar("Result")


class TrialRuns:
    """Runs of trials, plain and with derivatives by the parameters `moved`."""

    def __init__(self, model: StepModel, moved: Sequence[str], trials: Sequence[Trial]) -> None:
        self._trials = trials
        self._inputs = [trial_inputs(model, t) for t in trials]
        self._pool = ThreadPoolExecutor(WORKERS)
        self._plain, self._sensitive = self._pool.map(
            lambda wrt: CompiledModel(model, wrt), ((), moved)
        )

    def outputs(self, which: Iterable[int], p: Callable[[int], Array]) -> dict[int, Array]:
        """Outputs (n, outputs) of some trials; `p` gives the parameters by index."""

        def run(k: int) -> Array:
            first, u = self._inputs[k]
            values = p(k)
            start = self._plain.start(first, values)
            return self._plain.simulate(u, self._trials[k].step_s, values, start)

        return self._each(run, which)

    def slopes(
        self,
        which: Iterable[int],
        p: Callable[[int], Array],
        wanted: NDArray[np.bool_],
        use: Callable[[int, Array], Result],
    ) -> dict[int, Result]:
        """Results of `use` on the derivatives of the outputs of some trials.

        `wanted`, shape (moved,): parameters to differentiate by; derivatives by the others are
        zero. `use` reduces the derivatives (n, outputs, moved) of the trial with an index.
        """

        def run(k: int) -> Result:
            first, u = self._inputs[k]
            step_s = self._trials[k].step_s
            return use(k, self._sensitive.derivatives(u, step_s, p(k), first, wanted)[1])

        return self._each(run, which)

    def _each(self, run: Callable[[int], Result], which: Iterable[int]) -> dict[int, Result]:
        longest_first = sorted(which, key=lambda k: -len(self._trials[k]))
        done = dict(zip(longest_first, self._pool.map(run, longest_first), strict=True))
        return {k: done[k] for k in sorted(done)}


class Residuals:
    """Residual spectra of the twin with every effect, over trials."""

    def __init__(
        self,
        plant: Plant,
        trials: Sequence[Trial],
        fit_parameters: Sequence[FitParameter],
    ) -> None:
        dofs = {t.meta.dof for t in trials}
        if len(dofs) != 1:
            raise InputError("trials", "are of one and of two joints", "choose one kind with --dof")
        model = plant_with_every_effect(plant).step_model(dofs.pop(), "twin")
        is_link = plant.load == "link"
        if is_link:
            model = model.with_substeps(LONGEST_SUBSTEP_S)
        self.plant, self.model = plant, model
        self.trials = shortened(trials, model)
        self.fit_parameters = tuple(fit_parameters)
        trials = self.trials
        moved = [n for n in moved_parameters(fit_parameters) if n in names(model.parameters)]
        self._simulated = TrialRuns(self.model, moved, trials)
        self._outputs = names(model.outputs)
        self._base = [trial_parameters(model, t) for t in trials]
        self._low = np.array([v.minimum for v in model.parameters])
        self._high = np.array([v.maximum for v in model.parameters])
        self._set_directions(names(model.parameters), moved)
        self._measured = [measured_signals(t) for t in trials]
        self.groups = trial_groups(trials, self._outputs)
        self._follows = [np.ones(len(t)) for t in trials]
        if is_link:
            self._follows = [
                rows_that_follow(t, error)
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
            lambda k, derivatives: self._slope_spectra(k, group[k], derivatives, wanted),
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
            by_parameter = self._coefficients(k, signal, slopes[:, o, used], group.coefficients)
            level = self._coefficients(k, signal, np.ones(len(slopes)), group.coefficients)
            spectra[b][:, acting[wanted]] = by_parameter @ moved[used] + np.outer(
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
        return signal_spectrum(self.trials[k], signal, rows, self._follows[k], count)
