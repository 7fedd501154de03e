"""Separation of rival hypotheses: d′ that remains after one is refitted to the other's prediction.

The trials at hand and a planned one count together: the values of the rival may move as far as both
allow, and so may nuisance and the variation of each trial within their priors. The residual of the
refit, in noise floors, is the d′ of the pair (T-optimality: Atkinson and Fedorov, Biometrika 62,
1975). The refit is linearised with exact sensitivities and then simulated. Model, priors and noise
floor are those of the diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S
from models.gap.estimation.gauss_newton import (
    RIDGE,
    FitPoint,
    GaussNewton,
    NormalEquation,
    stacked,
)
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.nuisance_fit import NuisanceFit
from models.gap.experiment.rival import HypothesisRecord, fitted_values_of
from models.gap.residuals.residuals import Residuals
from models.plant.identification.fit import measured_signals
from models.plant.identification.residual_spectra import FitParameter
from models.plant.identification.trial_spectra import group_frequencies_hz, smoothed
from models.plant.step_model import Array
from models.trials.trial import Trial

REST_SAMPLES: Final = 60
"""Samples at rest before a planned motion [assumed]."""
REFIT_STEPS: Final = 4
"""Steps of a refit with the derivatives at its start, after which it no longer changes
[assumed]."""


@dataclass(frozen=True)
class Misfit:
    """Cost c − 2 g'φ + φ'Nφ of a change φ of the rival's fit parameters that all trials share."""

    constant: float
    gradient: Array
    normal: Array

    def cost(self, change: Array) -> float:
        rising = change @ self.normal @ change - 2 * self.gradient @ change
        return float(self.constant + rising)

    def least(self, free: Array) -> float:
        """d′ after the free parameters, shape (p,), were refitted."""
        index, change = np.flatnonzero(free), np.zeros(len(free))
        equation = NormalEquation.of(self.normal, index)
        change[index] = equation.solve(self.gradient[index], RIDGE)
        return float(np.sqrt(max(self.cost(change), 0.0)))


class PlannedRun(Residuals):
    """Trial of a motion that was not run yet; only differences of its residuals count."""

    def outputs(self, values: Array) -> dict[str, Array]:
        """Simulated outputs over time, by their name."""
        return dict(zip(self._outputs, self._runs(values)[0].T, strict=True))

    def spectrum(self, signal: str, rows: Array) -> Array:
        """Spectrum of the motion in a simulated output, without its rest."""
        return self._coefficients(0, signal, rows - rows[0], self.groups[0].coefficients)


class SeparationModel:
    """Rivals, and how well the trials at hand separate them.

    `pairs` are indices of rivals; the second of a pair is refitted. `before` is the d′ of each pair
    on the trials at hand.
    """

    def __init__(
        self,
        nuisance: NuisanceFit,
        rivals: Sequence[HypothesisRecord],
        pairs: Sequence[tuple[int, int]],
    ) -> None:
        self.estimator, self.floor = nuisance.estimator, nuisance.measured.floor
        residuals = self.estimator.residuals
        plant, every = residuals.plant, residuals.fit_parameters
        self.plant, self.rivals, self.pairs, self.like = plant, rivals, pairs, residuals.trials[0]
        _refuse_other_effects(rivals, every)
        self._own_error = _own_error_fraction(self.floor, residuals.trials)
        varies = np.array([q.trial is not None for q in every])
        starts = [self.estimator.at(fitted_values_of(r, plant, every)) for r in rivals]
        self._named = np.array(
            [not q.effect or any(q.effect in r.effects for r in rivals) for q in every]
        )
        points = [
            self.estimator.linearise(self.estimator.fit(s, varies), self._named) for s in starts
        ]
        # A planned trial shares nuisance and effects with the others, and has its own variation.
        of_one = [k for k, q in enumerate(every) if q.trial in (None, 0)]
        self.planned = [every[k] for k in of_one]
        self.values = [start.values[of_one] for start in starts]
        self._named, self._shared = self._named[of_one], ~varies[of_one]
        self._prior = np.array(
            [0.0 if q.trial is None else q.standard_deviation**-2 for q in self.planned]
        )
        self._free = [
            np.array([not q.effect or q.effect in r.effects for q in self.planned]) for r in rivals
        ]
        self._known = [_misfit(self.estimator, varies, points[a], points[b]) for a, b in pairs]
        self.before = tuple(
            known.least(self._free[b][self._shared])
            for known, (_, b) in zip(self._known, pairs, strict=True)
        )

    def planned_run(self, motion: Motion, payload_kg: float) -> PlannedRun:
        trial = planned_trial(self.like, motion, payload_kg)
        absent = dict.fromkeys(self.estimator.residuals.groups[0].signals, np.zeros(len(trial)))
        trial = replace(trial, columns=absent | trial.columns)
        return PlannedRun(self.plant, [trial], self.planned)

    def separations(self, run: PlannedRun) -> tuple[float, ...]:
        """d′ of every pair with the planned trial added."""
        estimator = GaussNewton(run, self.planned_floor(run))
        points = [estimator.linearise(estimator.at(v), self._named) for v in self.values]
        return tuple(
            self._refitted(k, estimator, points[a], points[b])
            for k, (a, b) in enumerate(self.pairs)
        )

    def added(self, separations: Sequence[float]) -> Array:
        """d′ that the planned trial itself adds to every pair."""
        return np.asarray(np.sqrt(np.square(separations) - np.square(self.before)))

    def planned_floor(self, run: PlannedRun) -> NoiseFloor:
        """Noise floor of a planned trial.

        As in the diagnosis, the equation of an effect misses a fraction of what it explains. The
        plant's own error is not known on a new motion. It is taken as the same fraction of the
        motion's spectrum as on the trials at hand, and as no less than there.
        """
        (group,) = run.groups
        truth = next(v for v, r in zip(self.values, self.rivals, strict=True) if r.effects)
        without = np.where([bool(q.effect) for q in self.planned], 0.0, truth)
        gap = run.residuals(without)[0] - run.residuals(truth)[0]
        floor = self.floor.widened([group], run.trials, [gap])
        if floor.curves_for(group, run.trials)[1] != "unknown":
            return floor
        ((payload_kg, missed),) = floor.formulation.items()
        hz, outputs = group_frequencies_hz(group, run.trials), run.outputs(truth)
        wider = {}
        for signal, power in missed.items():
            model_error = smoothed(run.spectrum(signal, outputs[signal]) ** 2)
            model_error *= self._own_error.get(signal, 0.0)
            wider[signal] = power + np.interp(floor.frequency_hz, hz, model_error)
        return replace(floor, formulation={payload_kg: wider})

    def _refitted(
        self, pair: int, estimator: GaussNewton, true: FitPoint, rival: FitPoint
    ) -> float:
        """d′ after the second rival of a pair was refitted to all trials."""
        known, shared, prior = self._known[pair], self._shared, self._prior
        free = np.flatnonzero(self._free[self.pairs[pair][1]])
        slopes = np.concatenate(rival.slopes)
        normal = slopes.T @ slopes + np.diag(prior)
        normal[np.ix_(shared, shared)] += known.normal
        equation = NormalEquation.of(normal, free)
        change, residual = np.zeros(len(prior)), _difference(estimator, true, rival.rows)
        best = known.constant + float(residual @ residual)
        for _ in range(REFIT_STEPS):
            gradient = slopes.T @ residual - prior * change
            gradient[shared] += known.gradient - known.normal @ change[shared]
            step = np.zeros(len(change))
            step[free] = equation.solve(gradient[free], RIDGE)
            values = np.clip(rival.values + change + step, estimator.low, estimator.high)
            change = values - rival.values
            residual = _difference(estimator, true, estimator.residuals.residuals(values))
            missed = float(residual @ residual + prior @ change**2)
            best = min(best, known.cost(change[shared]) + missed)
        return float(np.sqrt(max(best, self.before[pair] ** 2)))


def planned_trial(like: Trial, motion: Motion, payload_kg: float) -> Trial:
    """Trial of a motion before it is run: conditions and goals; the angles equal the goals."""
    goal_rad = motion.table_rad(rest_samples=REST_SAMPLES)
    columns: dict[str, Array] = {"time_s": PERIOD_S * np.arange(len(goal_rad), dtype=np.float64)}
    for j in range(motion.dof):
        columns[f"goal_{j + 1}_rad"] = columns[f"angle_{j + 1}_rad"] = goal_rad[:, j]
    meta = msgspec.structs.replace(
        like.meta, motion=motion.kind, payload_kg=payload_kg, period_s=motion.period_s,
        amplitude_rad=motion.amplitude_rad, phase_2_rad=motion.phase_2_rad,
        rest_samples=REST_SAMPLES, source="simulated",
    )  # fmt: skip
    return Trial(motion.kind, meta, columns)


def _refuse_other_effects(
    rivals: Sequence[HypothesisRecord], fit_parameters: Sequence[FitParameter]
) -> None:
    known = {q.effect for q in fit_parameters}
    for candidate in sorted({c for r in rivals for c in r.effects} - known):
        raise InputError(
            "gap.json", f"names {candidate!r}, no effect of this plant", "diagnose again"
        )


def _own_error_fraction(floor: NoiseFloor, trials: Sequence[Trial]) -> dict[str, float]:
    """Power of the plant's own error as a fraction of that of the motion, by signal."""
    result = {}
    measured = [measured_signals(t) for t in trials]
    for signal, spectrum in floor.model.items():
        moved = [m[signal] - m[signal][0] for m in measured if signal in m]
        power = float(np.mean([np.nanmean(m**2) for m in moved])) if moved else 0.0
        if power > 0:
            error = float(np.sum(spectrum)) / len(trials[0])
            result[signal] = min(error / power, 1.0)
    return result


def _difference(estimator: GaussNewton, true: FitPoint, rows: Sequence[Array]) -> Array:
    """What the rival misses of the true hypothesis, in noise floors, as one vector."""
    missed = [row - true_row for row, true_row in zip(rows, true.rows, strict=True)]
    return stacked(estimator.whiten(missed)).ravel()


def _misfit(
    estimator: GaussNewton, varies: NDArray[np.bool_], true: FitPoint, rival: FitPoint
) -> Misfit:
    """Cost of a pair on the trials at hand, with their own variation eliminated."""
    white, normal, prior = _difference(estimator, true, rival.rows), rival.normal, estimator.prior
    gradient = np.concatenate(rival.slopes).T @ white - prior @ rival.values
    by_prior = rival.values @ prior @ rival.values - true.values @ prior @ true.values
    v, s = np.flatnonzero(varies), np.flatnonzero(~varies)
    across, equation = normal[np.ix_(v, s)], NormalEquation.of(normal, v)
    by_shared, by_gradient = equation.solve(across, RIDGE), equation.solve(gradient[v], RIDGE)
    return Misfit(
        float(white @ white + by_prior - gradient[v] @ by_gradient),
        gradient[s] - across.T @ by_gradient,
        normal[np.ix_(s, s)] - across.T @ by_shared,
    )
