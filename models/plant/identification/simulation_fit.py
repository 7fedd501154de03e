"""Least-squares fit through the simulation: residuals over trials with exact derivatives.

A residual is (simulated − measured) / scale, divided by √C where C samples carry the information of
one, because residuals of a reduced model are far from white (docs/sources.md, "Naming a missing
effect"). Each free parameter also has a prior: its value before the fit, with `prior_deviation` or
a quarter of its bounds as standard deviation. Parameters that the data do not determine keep their
values.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from firmware_py.errors import InputError
from models.plant.effects import PULLEY_M
from models.plant.identification.cluster_errors import cluster_errors, grouped_rows
from models.plant.parameter import AT_BOUND, prior_deviation_of
from models.plant.plant import ModelKind, Plant
from models.plant.simulation.compiled_model import Array, trial_parameters
from models.plant.simulation.long_trials import shortened
from models.plant.simulation.sensitivity import SensitiveModel, run_sensitive_trial
from models.plant.step_model import names
from models.trials.deformation import deformation_index, marker_lengths_m
from models.trials.trial import Trial

SCALE: Final = {"m": 0.003, "1": 3e-4, "A": 0.1, "rad": 0.002, "V": 0.1}
"""Scale of a residual in a first fit, by the unit of the signal."""

LEAST_SCALE: Final = {"rad": 0.1}
"""Smallest fraction of `SCALE`, if not one half. An encoder resolves 0.01 mrad (docs/sources.md,
"Control tables"); 0.2 mrad separate the lag of the goal from the position gain."""

CORRELATED_SAMPLES: Final = 12
"""Samples that carry the information of one in a first fit (docs/sources.md, "Naming a missing
effect")."""

EFFORT_FRACTION: Final = 0.03
"""Scale of the residual of a torque or a force, relative to its RMS, as its size is unknown."""

STANDSTILL_RAD_S: Final = 0.1
"""Joint rate below which dry friction can take any value, so the current has a low weight."""

STANDSTILL_M_S: Final = STANDSTILL_RAD_S * PULLEY_M
"""The same on a straight guide."""

LARGEST_DERIVATIVE: Final = 1e60
"""Largest derivative of a stable simulation; squares of larger ones would overflow [assumed]."""

WORKERS: Final = 2


def measured_signals(trial: Trial) -> dict[str, Array]:
    """Columns of a trial, and its Deformation Index if it has markers."""
    signals = dict(trial.columns)
    if "m01_x_m" in signals and trial.meta.rest_samples:
        signals["di"] = _balanced_index(trial)
    return signals


def _balanced_index(trial: Trial) -> Array:
    """Deformation Index in which each segment of an edge has the same weight.

    The segments at the base strain most and need one marker, the others need two. So a mean over
    the visible lengths would rise with occlusion. Without occlusion this is `deformation_index`.
    """
    lengths = marker_lengths_m(trial)
    if np.isfinite(lengths).all():
        return deformation_index(trial)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=RuntimeWarning)  # an all-NaN mean is NaN
        reference = np.nanmean(lengths[: trial.meta.rest_samples], axis=0)
        strain = np.abs(lengths - reference) / reference
        by_row = strain.reshape(len(trial), trial.meta.layout.rows, -1)
        return np.asarray(np.nanmean(by_row, axis=2).mean(axis=1))


def usual_error(unit: str, measured: Sequence[Array]) -> float:
    """Expected error of a signal before a first fit, in its unit; `measured` holds arrays (n,)."""
    if unit in SCALE:
        return SCALE[unit]
    rms = float(np.sqrt(np.nanmean(np.concatenate(measured) ** 2))) if measured else 0.0
    return EFFORT_FRACTION * max(rms, 1e-9)


def row_weights(trial: Trial, signal: str) -> Array:
    """Square root of the weight of each row of a signal.

    A current is weighted by its joint's rate if that was measured; all else has the weight one.
    """
    if not signal.startswith("current_"):
        return np.ones(len(trial))
    joint = signal.split("_")[1]
    standstill = {f"angle_{joint}_rad": STANDSTILL_RAD_S, f"position_{joint}_m": STANDSTILL_M_S}
    for name, still in standstill.items():
        if name in trial.columns:
            rate = np.gradient(trial.columns[name], trial.step_s)
            return np.asarray(np.sqrt(rate**2 / (rate**2 + still**2)))
    return np.ones(len(trial))


@dataclass(frozen=True)
class Solution:
    """Result of a fit."""

    plant: Plant  # Plant with the fitted values and their standard errors
    free: tuple[str, ...]  # Names of the fitted parameters
    cost: float  # Half the sum of squares, prior included
    rms: dict[str, float]  # Root mean square residual of each signal, in its unit


class Objective:
    """Residuals of a plant over trials, as a function of some parameters.

    `plant` sets the other parameters and the priors of the free ones; the values of `prior` are the
    centres of the priors (by default, those of `plant`).
    """

    def __init__(
        self,
        plant: Plant,
        kind: ModelKind,
        trials: Sequence[Trial],
        free: Sequence[str],
        signals: Sequence[str],
        scale: Mapping[str, float] | None = None,
        max_substep_s: float | None = None,
        prior: Plant | None = None,
    ) -> None:
        self.plant, self.free = plant, tuple(free)
        self._signals, self._scale = tuple(signals), dict(scale or {})
        self._models: dict[int, SensitiveModel] = {}
        used: list[Trial] = []
        for dof in sorted({t.meta.dof for t in trials}):
            model = plant.step_model(dof, kind)
            same = [t for t in trials if t.meta.dof == dof]
            used += shortened(same, model, max_substep_s or model.max_substep_s)
            own = [name for name in self.free if name in names(model.parameters)]
            self._models[dof] = SensitiveModel(model, own, max_substep_s)
        self.trials = tuple(used)
        self._measured = [measured_signals(t) for t in used]
        chosen = [plant.parameters[name] for name in self.free]
        self.start = np.array([q.value for q in chosen])
        self.low = np.array([q.low for q in chosen])
        self.high = np.array([q.high for q in chosen])
        self.prior_deviation = np.array([prior_deviation_of(q) for q in chosen])
        self._centre = np.array([(prior or plant).parameters[n].value for n in self.free])
        self._last: tuple[bytes, Array, Array] = (b"", np.empty(0), np.empty(0))

    def __call__(self, values: Array) -> tuple[Array, Array]:
        """Residuals (n,) and their Jacobian (n, len(free)); those of the priors come last."""
        key = values.tobytes()
        if key != self._last[0]:
            with ThreadPoolExecutor(WORKERS) as pool:
                parts = list(pool.map(lambda k: self._trial(k, values), range(len(self.trials))))
            prior = (values - self._centre) / self.prior_deviation
            residual = np.concatenate([r for rows in parts for r, _ in rows.values()] + [prior])
            jacobian = np.concatenate(
                [j for rows in parts for _, j in rows.values()]
                + [np.diag(1 / self.prior_deviation)]
            )
            if not (np.abs(jacobian) < LARGEST_DERIVATIVE).all():
                residual = np.full_like(residual, np.inf)  # unstable: the fit must not step here
            self._last = (key, residual, jacobian)
        return self._last[1], self._last[2]

    def rms(self, values: Array) -> dict[str, float]:
        """Weighted root mean square residual of each signal, in its unit."""
        squares: dict[str, list[Array]] = {}
        for k in range(len(self.trials)):
            for signal, (residual, _) in self._trial(k, values).items():
                if len(residual):
                    squares.setdefault(signal, []).append(residual**2 * CORRELATED_SAMPLES)
        return {
            signal: float(np.sqrt(np.mean(np.concatenate(rows)))) * self.scale(signal)
            for signal, rows in squares.items()
        }

    def runaway_trials(self, values: Array) -> list[str]:
        """Files of the trials on which the simulation or its derivatives do not stay finite."""
        return [
            str(trial.path) for k, trial in enumerate(self.trials)
            if not all(
                np.isfinite(r).all() and (np.abs(j) < LARGEST_DERIVATIVE).all()
                for r, j in self._trial(k, values).values()
            )
        ]  # fmt: skip

    def standard_errors(self, values: Array) -> Array:
        """Standard errors at the solution (`models.plant.identification.cluster_errors`)."""
        rows = [
            (trial, np.isfinite(self._measured[k][signal]), *values_of)
            for k, trial in enumerate(self.trials)
            for signal, values_of in self._trial(k, values).items()
        ]
        by_load, by_part = grouped_rows(rows)
        information = np.diag(self.prior_deviation**-2.0)
        information = information + sum(g.information for g in by_load.values())
        margin = AT_BOUND * (self.high - self.low)
        low, high = self.low - values, self.high - values
        low, high = np.where(low > -margin, 0.0, low), np.where(high < margin, 0.0, high)
        return cluster_errors((by_load, by_part), information, low, high)

    def scale(self, signal: str) -> float:
        """Scale of a signal's residual, at least `LEAST_SCALE` of its `SCALE`.

        With a smaller scale, a signal that hardly moves (the end effector across a single joint's
        plane) would outweigh all others.
        """
        outputs = (v for compiled in self._models.values() for v in compiled.model.outputs)
        unit = next(v.unit for v in outputs if v.name == signal)
        default = usual_error(unit, [m[signal] for m in self._measured if signal in m])
        return max(self._scale.get(signal, default), LEAST_SCALE.get(unit, 0.5) * default)

    def _trial(self, index: int, values: Array) -> dict[str, tuple[Array, Array]]:
        """Residual and Jacobian of each signal of a trial."""
        trial, measured = self.trials[index], self._measured[index]
        compiled = self._models[trial.meta.dof]
        model, own = compiled.model, compiled.wrt
        known = names(model.parameters)
        p = trial_parameters(model, trial)
        columns = [self.free.index(name) for name in own]
        p[[known.index(name) for name in own]] = values[columns]
        y, slopes = run_sensitive_trial(compiled, trial, p)
        result: dict[str, tuple[Array, Array]] = {}
        for k, signal in enumerate(names(model.outputs)):
            if signal not in measured or not signal.startswith(self._signals):
                continue
            factor = row_weights(trial, signal) / self.scale(signal) / CORRELATED_SAMPLES**0.5
            residual = (y[:, k] - measured[signal]) * factor
            jacobian = np.zeros((len(y), len(self.free)))
            jacobian[:, columns] = slopes[:, k] * factor[:, None]
            seen = np.isfinite(measured[signal])
            result[signal] = (residual[seen], jacobian[seen])
        return result


def fit_objective(
    objective: Objective,
    start: Array | None = None,
    evaluations: int = 40,
    tolerance: float = 1e-4,
    report: Callable[[float], None] = lambda cost: None,
) -> Solution:
    """Fit by a trust-region Gauss–Newton method within the bounds."""

    def residuals(values: Array) -> Array:
        result = objective(values)[0]
        report(0.5 * float(result @ result))
        return result

    margin = 1e-9 * (objective.high - objective.low)
    first = np.clip(objective.start if start is None else start,
                    objective.low + margin, objective.high - margin)  # fmt: skip
    if not np.isfinite(objective(first)[0]).all():
        raise InputError(
            f"plant {objective.plant.name!r}",
            f"does not stay finite on {', '.join(objective.runaway_trials(first)) or 'a trial'}",
            "start from other values of its parameters, or check the conditions of the trials",
        )
    found = least_squares(
        residuals, first, lambda values: objective(values)[1],
        bounds=(objective.low, objective.high), x_scale="jac", method="trf",
        max_nfev=evaluations, ftol=tolerance, xtol=1e-6, gtol=1e-8,
    )  # fmt: skip
    values = np.clip(found.x, objective.low, objective.high)
    residual, _ = objective(values)
    errors = objective.standard_errors(values)
    plant = objective.plant.with_values(
        dict(zip(objective.free, values, strict=True)),
        dict(zip(objective.free, errors, strict=True)),
    )
    cost = 0.5 * float(residual @ residual)
    return Solution(plant, objective.free, cost, objective.rms(values))
