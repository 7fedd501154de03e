"""Errors on trials that no value was fitted to, in SI units, by simulation.

Payloads, other conditions and motions are left out in turn; repetitions where the trials differ in
none of these, blocks of time where there is one trial (`models.gap.residuals.time_blocks`; of a
plant that cannot begin in motion, rows of the one simulation). Starting from a fit of all trials, a
few Gauss–Newton steps without the fold, with the priors, give the values that the other trials
alone determine. With these the fold is simulated as the plant file would simulate it: without
variation of the trial and without a shift of the frame. The errors are compared with those of the
plant that is diagnosed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from models.gap.estimation.gauss_newton import CONVERGED_FALL, FitPoint, GaussNewton, Mask
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.residuals.residuals import Residuals
from models.gap.residuals.time_blocks import BLOCKS, is_time_block
from models.plant.identification.trial_spectra import TrialGroup
from models.plant.plant import Plant
from models.plant.step_model import Array
from models.trials.trial import Trial


@dataclass(frozen=True)
class SquaredError:
    """Sum of the squared errors of a signal, in its SI unit squared, over `rows` samples."""

    sum: float
    rows: int


class PartialResiduals(Residuals):
    """Residuals in which only some rows count; trials without any are left out.

    `counted`: by index of the trial, 1 for each row that counts, 0 otherwise, shape (n,).
    `derivatives`: returns the derivatives of `whole` from values and the wanted fit parameters, as
    `Residuals.jacobian` does: one run of all trials serves every part of them.
    """

    def __init__(
        self,
        whole: Residuals,
        counted: Mapping[int, Array],
        derivatives: Callable[[Array, NDArray[np.bool_]], list[Array]],
    ) -> None:
        vars(self).update(vars(whole))
        self._derivatives = derivatives
        self._parts = [
            [a for a, k in enumerate(g.trials) if k in counted and counted[k].any()]
            for g in whole.groups
        ]
        in_part = [(g, part) for g, part in zip(whole.groups, self._parts, strict=True) if part]
        self.groups = [replace(g, trials=tuple(g.trials[a] for a in part)) for g, part in in_part]
        self._follows = [
            rows * counted.get(k, np.zeros(len(rows))) for k, rows in enumerate(whole._follows)
        ]

    def jacobian(self, values: Array, wanted: NDArray[np.bool_]) -> list[Array]:
        """Derivatives as in `Residuals.jacobian`, selected from those of all trials."""
        derivatives = self._derivatives(values, wanted)
        slopes = [s[part] for s, part in zip(derivatives, self._parts, strict=True) if part]
        return [
            np.moveaxis(self.as_counted(g, np.moveaxis(s, -1, 0)), 0, -1)
            for g, s in zip(self.groups, slopes, strict=True)
        ]

    def squared_errors(self, values: Array) -> dict[str, SquaredError]:
        """Raw errors by signal, over the rows that count and were measured.

        Shapes: `values` (p,).
        """
        total: dict[str, SquaredError] = {}
        runs = self._runs(values)
        for group in self.groups:
            for k in group.trials:
                y, counts = runs[k], self._follows[k] > 0
                for signal in group.signals:
                    error = y[:, self._outputs.index(signal)] - self._measured[k][signal]
                    error = error[counts & np.isfinite(self._measured[k][signal])]
                    known = total.get(signal, SquaredError(0.0, 0))
                    total[signal] = SquaredError(
                        known.sum + float(error @ error), known.rows + len(error)
                    )
        return total


LEAST_SQUARE = 1e-300
"""Least mean square, so that the ratio of two errors of zero is 1."""
STEPS: Final = 3
"""Most steps of the fit without a fold, starting from the fit of all trials [assumed]."""
LEAST_FALL_FRACTION: Final = 0.03
"""Least fall of the held-out error that an effect must bring where no noise floor is learned
[assumed]."""

Fold = dict[int, Array]
"""Rows that are left out together: 1 for each such row, by index of the trial."""

FOLD_KEYS: Final[Mapping[str, Callable[[Trial], object]]] = {
    "payloads": lambda t: t.meta.payload_kg,
    "conditions": lambda t: sorted(t.meta.conditions.items()),
    "motions": lambda t: (t.meta.motion, t.meta.amplitude_rad, t.meta.period_s),
}
"""Property shared by trials that are left out together, by the name of what is left out."""


def held_out_folds(trials: Sequence[Trial]) -> dict[str, list[Fold]]:
    """Folds, by the name of what is left out."""
    folds_of: dict[str, list[Fold]] = {}
    for words, key in FOLD_KEYS.items():
        folds = _by_value(trials, key)
        if len(folds) > 1:
            folds_of[words] = folds
    if len(trials) > 1 and all(is_time_block(t) for t in trials):
        return {"blocks of time": folds_of["motions"]}
    if folds_of:
        return folds_of
    if len(trials) > 1:
        return {"repetitions": _by_value(trials, lambda t: t.name)}
    edges = np.linspace(0, len(trials[0]), BLOCKS + 1).astype(int)
    place = np.arange(len(trials[0]))
    blocks = [
        {0: ((place >= a) & (place < b)).astype(np.float64)} for a, b in itertools.pairwise(edges)
    ]
    return {"blocks of time": blocks}


def _by_value(trials: Sequence[Trial], key: Callable[[Trial], object]) -> list[Fold]:
    folds: dict[str, Fold] = {}
    for k, trial in enumerate(trials):
        folds.setdefault(str(key(trial)), {})[k] = np.ones(len(trial))
    return list(folds.values())


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors of a model on trials that it was not fitted to."""

    folds: tuple[Mapping[str, SquaredError], ...]

    def rms(self) -> dict[str, float]:
        """Root mean square of each signal over all folds, in its SI unit."""
        result = {}
        for signal in dict.fromkeys(s for fold in self.folds for s in fold):
            parts = [fold[signal] for fold in self.folds if signal in fold]
            rows = sum(p.rows for p in parts)
            if rows:
                result[signal] = float(np.sqrt(sum(p.sum for p in parts) / rows))
        return result

    def ratios(self, other: HeldOutErrors) -> dict[str, float]:
        """Root mean square of each signal over that of another model."""
        ours, theirs = self.rms(), other.rms()
        return {s: _ratio(ours[s] ** 2, theirs[s] ** 2) for s in ours}

    def fraction_of(self, other: HeldOutErrors) -> float:
        """Geometric mean of `ratios`: below one where errors are smaller than the other's."""
        return float(np.exp(np.mean(np.log(list(self.ratios(other).values())))))

    def falls_from(self, other: HeldOutErrors) -> Array:
        """Logarithm of the other's errors over these, mean over signals, by fold."""
        return np.array(
            [
                -np.mean(
                    [np.log(_ratio(errors[s].sum, others[s].sum)) for s in errors if errors[s].rows]
                )
                for errors, others in zip(self.folds, other.folds, strict=True)
            ]
        )


def _ratio(error: float, other: float) -> float:
    """Ratio of the roots of two squares; a model that does not stay finite counts as far worse."""
    if not np.isfinite(error):
        return 1e6
    return float(np.sqrt((error + LEAST_SQUARE) / (other + LEAST_SQUARE)))


class HeldOut:
    """Folds of the trials of a search, each with an estimator of all other trials."""

    def __init__(self, estimator: GaussNewton) -> None:
        self.estimator, self.residuals = estimator, estimator.residuals
        self.folds = held_out_folds(self.residuals.trials)
        self._known: tuple[tuple[bytes, bytes], list[Array]] = ((b"", b""), [])
        self._parts = [self._part(fold) for folds in self.folds.values() for fold in folds]
        unchanged = np.zeros(len(self.residuals.fit_parameters))
        self.baseline = self._errors([unchanged] * len(self._parts))

    def errors(self, point: FitPoint, free: Mask) -> HeldOutErrors:
        """Errors on each fold of a model that was fitted to all others.

        Shapes: `free` (p,).
        """
        values = [self._refitted(rest, point, free) for rest, _ in self._parts]
        plant = self.residuals.plant
        written = [is_written(plant, self.residuals, k, free) for k in range(len(point.values))]
        return self._errors([v * written for v in values])

    def _part(self, fold: Fold) -> tuple[GaussNewton, PartialResiduals]:
        """Estimator without a fold, and residuals of the fold."""
        all_rows = {k: np.ones(len(t)) for k, t in enumerate(self.residuals.trials)}
        rest = {k: rows - fold.get(k, 0 * rows) for k, rows in all_rows.items()}
        remaining = PartialResiduals(self.residuals, rest, self._derivatives)
        part = PartialResiduals(self.residuals, fold, self._derivatives)
        return GaussNewton(remaining, self.estimator.floor), part

    def _derivatives(self, values: Array, wanted: NDArray[np.bool_]) -> list[Array]:
        """Derivatives of all trials, cached for the last values."""
        key = values.tobytes(), wanted.tobytes()
        if self._known[0] != key:
            self._known = key, self.residuals.jacobian(values, wanted)
        return self._known[1]

    def _refitted(self, rest: GaussNewton, point: FitPoint, free: Mask) -> Array:
        """Values after a few steps without a fold, the derivatives updated by secants."""
        here = rest.linearise(rest.at(point.values), free)
        for _ in range(STEPS):
            step, predicted = rest.step(here, free)
            better = None
            if predicted >= CONVERGED_FALL / 2:
                better = rest.line_search(here, step)
            if better is None:
                break
            here = better
        return here.values

    def _errors(self, values: Sequence[Array]) -> HeldOutErrors:
        rows = [part.squared_errors(v) for (_, part), v in zip(self._parts, values, strict=True)]
        return HeldOutErrors(tuple(rows))


def is_written(plant: Plant, residuals: Residuals, k: int, free: Mask) -> bool:
    """Whether a fit parameter changes the plant that would be written.

    The variation of a trial does not. A shift of the mocap frame and its clock do only if the plant
    has that effect, or it is among the effects in `free`, shape (p,), which would be added.
    """
    q = residuals.fit_parameters[k]
    if q.trial is not None:
        return False
    if q.effect:
        return True
    added = {
        name
        for other, fitted in zip(residuals.fit_parameters, free, strict=True)
        if fitted and other.effect
        for name in other.parameters
    }
    return any(name in plant.parameters or name in added for name in q.parameters)


def lowers_held_out_error(with_: HeldOutErrors, without: HeldOutErrors, is_further: bool) -> bool:
    """Whether an effect lowers the held-out errors by more than chance, and by a least fraction.

    The mean fall over the folds must exceed its standard error (the one-standard-error rule of
    Breiman et al. 1984). A further effect, one of many that are tried beside the first, must pass
    Student's t-test at 2.5 %.
    """
    falls = with_.falls_from(without)
    count, error, times = len(falls), 0.0, 1.0
    if count > 1:
        error = float(np.std(falls, ddof=1) / np.sqrt(count))
        times = float(student.ppf(0.975, count - 1)) if is_further else 1.0
    fraction = with_.fraction_of(without)
    return fraction < 1 - LEAST_FALL_FRACTION and float(np.mean(falls)) > times * error


def flattened(floor: NoiseFloor, groups: Sequence[TrialGroup], rows: Sequence[Array]) -> NoiseFloor:
    """Floor with the power of a residual, equal at all frequencies.

    A fit against it lowers the error in SI units. Without a learned floor the spectrum of the
    residual contains the gap itself and would discount the slow errors, which are the largest.

    Shapes: `rows` (trials, signals, K).
    """
    noise = {}
    for signal, spectrum in floor.noise.items():
        signal_rows = [
            r[:, g.signals.index(signal)].ravel()
            for g, r in zip(groups, rows, strict=True)
            if signal in g.signals
        ]
        noise[signal] = np.full_like(spectrum, np.mean(np.concatenate(signal_rows) ** 2))
    return replace(floor, noise=noise, formulation={})
