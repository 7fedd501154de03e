"""Separation of rival hypotheses: d′ that remains after one is refitted to the other's prediction.

The present trials and a planned one count together: the values of the rival may move as far as both
allow, and so may nuisance and the variation of each trial within their priors. The residual of the
refit, in noise floors, is the d′ of the pair (T-optimality: Atkinson and Fedorov, Biometrika 62,
1975). The refit is linearised with exact sensitivities and then simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.model_discrepancy import ModelDiscrepancy
from models.gap.estimation.noise_floor_fit import noise_floor_for, nuisance_and_variation
from models.gap.estimation.normal_equation import NormalEquation
from models.gap.experiment.motion_twin import MotionTwin
from models.gap.experiment.rival import Rival, fitted_values_of
from models.gap.residuals.fit_parameters import FitParameter, effect_fit_parameters
from models.gap.residuals.prior import prior_precision
from models.gap.residuals.residuals import Residuals
from models.gap.settings import GapSettings
from models.plant.identification.fit import measured_signals, row_weights
from models.plant.identification.noise_floor import (
    Array,
    TrialGroup,
    coefficient_count,
    cosine_transform,
    smoothed,
    trial_group_key,
)
from models.plant.plant import Plant
from models.trials.trial import Trial

REFIT_STEPS: Final = 2
"""Steps of a refit with the derivatives at its start [assumed]."""


@dataclass(frozen=True)
class Quadratic:
    """Cost c − 2 g'φ + φ'Nφ of a change φ of the fit parameters that all trials share."""

    constant: float
    gradient: Array
    normal: Array

    def cost(self, change: Array) -> float:
        rising = change @ self.normal @ change - 2 * self.gradient @ change
        return float(self.constant + rising)


@dataclass(frozen=True)
class PairSeparation:
    """d′ of a pair, and the refit of the second rival."""

    separation: float  # With the present trials and the planned one together
    before: float  # With the present trials alone
    refitted: Array  # (p,), all fit parameters of the second rival after its refit
    residual: Array  # (signals * K,), residual of the refit on the planned trial, in noise floors

    @property
    def gained(self) -> float:
        """d′ that the planned trial adds to the present ones."""
        return float(max(self.separation**2 - self.before**2, 0.0) ** 0.5)


class SeparationModel:
    """Rivals, and their costs on the present trials."""

    def __init__(
        self, plant: Plant, trials: Sequence[Trial], rivals: Sequence[Rival], settings: GapSettings,
        patterns: Sequence[ModelDiscrepancy] = (),
    ) -> None:  # fmt: skip
        self.rivals, self.settings, self.like = tuple(rivals), settings, trials[0]
        effects = sorted({e for r in rivals for e in r.effects})
        dof = trials[0].meta.dof
        separate = settings.separate_joints
        own = [q for e in effects for q in effect_fit_parameters(plant, e, dof, separate)]
        every = nuisance_and_variation(plant, trials, settings) + own
        residuals = Residuals(plant, trials, every, settings)
        self._estimator = GaussNewton(residuals, noise_floor_for(residuals, patterns))
        floor = self._estimator.floor
        self.floor = replace(floor, formulation={})
        self.signals = residuals.groups[0].signals
        # The planned trial has nuisance and effects in common with the others, and its variation.
        planned = nuisance_and_variation(plant, trials[:1], settings) + own
        self.fit_parameters = tuple(replace(q, trial=None) for q in planned)
        self._varies = np.array([q.kind == "trial" for q in planned])
        self._shared = np.flatnonzero(~self._varies)
        self._precision = prior_precision(planned)
        self.low = np.array([q.low for q in planned])
        self.high = np.array([q.high for q in planned])
        self._free = [
            np.array([not q.effect or q.effect in r.effects for q in planned]) for r in rivals
        ]
        self.values = [fitted_values_of(r, plant, planned) for r in rivals]
        self.twin = MotionTwin(residuals.model, self.fit_parameters)
        self._error_fraction = self._own_error_fraction(trials)
        self.pairs = [
            (a, b) if len(rivals[a].effects) >= len(rivals[b].effects) else (b, a)
            for a, b in combinations(range(len(rivals)), 2)
        ]
        self._known = self._trials_at_hand(plant, every)

    def _trials_at_hand(self, plant: Plant, every: Sequence[FitParameter]) -> list[Quadratic]:
        """Cost of each pair on the present trials, with their own variation eliminated."""
        estimator = self._estimator
        points = [
            estimator.linearise(estimator.at(fitted_values_of(r, plant, every)))
            for r in self.rivals
        ]
        varies = np.array([q.trial is not None for q in every])
        result = []
        for a, b in self.pairs:
            rows = [
                second - first for first, second in zip(points[a].rows, points[b].rows, strict=True)
            ]
            white = np.concatenate([w.ravel() for w in estimator.whiten(rows)])
            slopes = np.concatenate(points[b].slopes)
            gradient = slopes.T @ white
            v, s = np.flatnonzero(varies), np.flatnonzero(~varies)
            equation = NormalEquation.of(points[b].normal, v)
            ridge = self.settings.normal_ridge_fraction
            both = np.column_stack([points[b].normal[np.ix_(v, s)], gradient[v]])
            solved = equation.solve(both, ridge)
            result.append(
                Quadratic(
                    float(white @ white - gradient[v] @ solved[:, -1]),
                    gradient[s] - both[:, :-1].T @ solved[:, -1],
                    points[b].normal[np.ix_(s, s)] - both[:, :-1].T @ solved[:, :-1],
                )
            )
        return result

    def before(self, pair: int) -> float:
        """d′ of a pair on the present trials."""
        known, free = self._known[pair], self._free[self.pairs[pair][1]][self._shared]
        index = np.flatnonzero(free)
        solution = NormalEquation.of(known.normal, index).solve(
            known.gradient[index], self.settings.normal_ridge_fraction
        )
        left = float(known.constant - known.gradient[index] @ solution)
        return left**0.5 if left > 0 else 0.0

    def whitening(self, trial: Trial) -> Array:
        """Inverse noise floor of a planned trial, shape (signals, K).

        The plant's own error is not known on a new motion. It is taken as the same fraction of the
        motion's own spectrum as on the trials that the floor was measured on, and as no less than
        there.
        """
        count = coefficient_count(len(trial), trial.step_s)
        group = TrialGroup(trial_group_key(trial), (0,), self.signals, count)
        known = np.asarray(self.floor.whitener(group, [trial], self.settings)[:, :, 0, 0])
        if self.floor.curves_for(group, [trial])[1] != "unknown":
            return known
        plain = np.ones_like(known)
        y = self.twin.run(trial, self.values[0])
        rows = self.spectra(trial, y - y[0], plain).reshape(plain.shape)
        if not np.isfinite(rows).all():
            return known
        power = smoothed(rows**2)
        scale = np.where(known > 0, 1.0, 0.0)
        variance = 1 / np.maximum(known, 1e-300) ** 2 + self._error_fraction[:, None] * power
        return np.asarray(scale / np.sqrt(variance))

    def _own_error_fraction(self, trials: Sequence[Trial]) -> Array:
        """Power of the plant's own error as a fraction of that of the motion, by signal."""
        result = np.zeros(len(self.signals))
        for b, signal in enumerate(self.signals):
            if signal in self.floor.model:
                every = [m[signal] for m in map(measured_signals, trials) if signal in m]
                moved = [m - m[0] for m in every]
                power = float(np.mean([np.nanmean(m**2) for m in moved])) if moved else 0.0
                error = float(np.mean(self.floor.model[signal]))
                count = len(self.floor.model[signal]) / len(trials[0])
                result[b] = error * count / power if power > 0 else 0.0
        return np.asarray(np.minimum(result, 1.0))

    def spectra(self, trial: Trial, y: Array, white: Array) -> Array:
        """Outputs (n, outputs[, …]) in noise floors, (signals * K[, …]).

        Shapes: `white` (signals, K).
        """
        rows = []
        for b, signal in enumerate(self.signals):
            own = y[:, self.twin.outputs.index(signal)]
            weight = row_weights(trial, signal).reshape(-1, *[1] * (own.ndim - 1))
            scale = white[b].reshape(-1, *[1] * (own.ndim - 1))
            rows.append(scale * cosine_transform(weight * own, white.shape[1]))
        return np.concatenate(rows)

    def separations(self, trial: Trial) -> list[PairSeparation]:
        """d′ of every pair with the planned trial added."""
        white = self.whitening(trial)
        both = [self.twin.slopes(trial, v) for v in self.values]
        if not all(np.isfinite(y).all() and np.isfinite(s).all() for y, s in both):
            nothing = [self.before(k) for k in range(len(self.pairs))]
            empty = np.zeros(white.size)
            return [
                PairSeparation(d, d, self.values[b], empty)
                for d, (_, b) in zip(nothing, self.pairs, strict=True)
            ]
        rows = [self.spectra(trial, y, white) for y, _ in both]
        slopes = [self.spectra(trial, s, white) for _, s in both]
        return [
            self._refitted(k, trial, white, rows[a], rows[b], slopes[b])
            for k, (a, b) in enumerate(self.pairs)
        ]

    def _refitted(
        self, pair: int, trial: Trial, white: Array, true: Array, rival: Array, slopes: Array
    ) -> PairSeparation:
        """Refit of the second rival of a pair to the present trials and the planned one."""
        b, known, shared = self.pairs[pair][1], self._known[pair], self._shared
        index = np.flatnonzero(self._free[b])
        prior = np.where(self._varies, self._precision, 0.0)
        normal = slopes.T @ slopes + np.diag(prior)
        normal[np.ix_(shared, shared)] += known.normal
        equation = NormalEquation.of(normal, index)
        change, residual = np.zeros(len(self.low)), true - rival
        best = known.cost(change[shared]) + float(residual @ residual)
        kept, left = change, residual
        for _ in range(REFIT_STEPS):
            gradient = slopes.T @ residual - prior * change
            gradient[shared] += known.gradient - known.normal @ change[shared]
            step = np.zeros(len(change))
            step[index] = equation.solve(gradient[index], self.settings.normal_ridge_fraction)
            values = np.clip(self.values[b] + change + step, self.low, self.high)
            change = values - self.values[b]
            residual = true - self.spectra(trial, self.twin.run(trial, values), white)
            cost = known.cost(change[shared]) + float(residual @ residual + prior @ change**2)
            if cost < best:
                best, kept, left = cost, change, residual
        before = self.before(pair)
        return PairSeparation(
            float(np.sqrt(best)) if best > before**2 else before,
            before,
            self.values[b] + kept,
            left,
        )
