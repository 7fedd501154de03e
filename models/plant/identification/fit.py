"""Least-squares fit of a plant through its simulation, with exact derivatives.

A residual is (simulated − measured) / scale, divided by √C where C samples carry the information of
one, because residuals of a reduced model are far from white (docs/sources.md, "Naming a missing
effect"). Each free parameter also has a prior: its value before the fit, with `prior_deviation` or
a quarter of its bounds as standard deviation. Parameters that the data do not determine keep their
values.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student_t

from firmware_py.core.errors import InputError
from models.plant.components import DRIVES, LOADS
from models.plant.effects import EFFECTS
from models.plant.parameter import AT_BOUND, prior_deviation_of
from models.plant.plant import ModelKind, Plant, scope_of
from models.plant.simulation.runner import (
    Array,
    CompiledModel,
    differentiate_trial,
    trial_parameters,
)  # fmt: skip
from models.plant.step_model import StepModel, names
from models.trials.deformation import deformation_index
from models.trials.trial import Trial

LINK_SIGNALS: Final = ("tip", "di", "current")
"""Signals that a link is fitted to, by the start of their names."""


def free_parameters(plant: Plant, trials: Iterable[Trial]) -> tuple[list[str], list[str]]:
    """Parameters to fit with the link and with the drive; friction is in both."""
    scope = scope_of(plant.drive, plant.load, max(t.meta.dof for t in trials))

    def free(part: Any) -> list[str]:
        declared = [q.name for q in part.parameters(scope)]
        return [name for name in declared if plant.parameters[name].role != "fixed"]

    load, drive = free(LOADS[plant.load]()), free(DRIVES[plant.drive]())
    for effect in (EFFECTS[name] for name in plant.effects):
        if effect.port != "command":
            load += free(effect())
        if effect.port in ("command", "servo_torque"):
            drive += free(effect())
    load += [n for n in drive if n.startswith(("rotor_inertia_", "torque_constant_"))]  # in current
    return load, drive


# Signals of a trial, their scales and weights

SCALE: Final = {"m": 0.003, "1": 3e-4, "A": 0.1, "rad": 0.002, "V": 0.1}
"""Scale of a residual in a first fit, by the unit of the signal."""

LEAST_SCALE: Final = {"rad": 0.1}
"""Smallest fraction of `SCALE`, if not one half. An encoder resolves 0.01 mrad (docs/sources.md,
"Control tables"); 0.2 mrad separate the lag of the goal from the position gain."""

CORRELATED_SAMPLES: Final = 12  # that carry the information of one (docs/sources.md, as above)

STANDSTILL: Final = {"angle_{}_rad": 0.1, "position_{}_m": 0.01}
"""Joint rate, in rad/s or on a guide in m/s, below which dry friction can take any value, so that
the current has a low weight [assumed]."""


def measured_signals(trial: Trial) -> dict[str, Array]:
    """Columns of a trial, and its Deformation Index if it has markers; NaN if they are occluded."""
    signals = dict(trial.columns)
    if "m01_x_m" in signals and trial.meta.rest_samples:
        try:
            signals["di"] = deformation_index(trial)
        except InputError:  # no reference at rest
            signals["di"] = np.full(len(trial), np.nan)
    return signals


def usual_error(unit: str, measured: Sequence[Array]) -> float:
    """Expected error of a signal before a first fit, in its unit; `measured` holds arrays (n,).

    For a torque or a force, whose size is unknown, it is 3 % of its root mean square.
    """
    if unit in SCALE:
        return SCALE[unit]
    rms = float(np.sqrt(np.nanmean(np.concatenate(measured) ** 2))) if measured else 0.0
    return 0.03 * max(rms, 1e-9)


def row_weights(trial: Trial, signal: str) -> Array:
    """Square root of the weight of each row of a signal.

    A current is weighted by its joint's rate if that was measured; all else has the weight one.
    """
    if signal.startswith("current_"):
        for pattern, standstill in STANDSTILL.items():
            joint = trial.columns.get(pattern.format(signal.split("_")[1]))
            if joint is not None:
                rate = np.gradient(joint, trial.step_s)
                return np.asarray(np.sqrt(rate**2 / (rate**2 + standstill**2)))
    return np.ones(len(trial))


# Long trials. A fit simulates its trials some hundred times. The cost of a simulation, its state
# updates, is rows times sub-steps times states. So a fit uses the first rows of very long trials:
# they begin at rest, so the state at the start is known. Whatever is simulated once (`evaluate`)
# uses whole trials; there the rest of a cut trial is held out.

MOST_OF_TRIAL: Final = 3e6
"""Most state updates in one simulation of a trial: 20 800 rows of the link with every effect and
one joint, 430 000 rows of a mass on a guide at 1 kHz. Measured: 1.6 s of processor time for the
exact derivatives of the former; a diagnosis needs about twenty of them."""

MOST_OF_ALL: Final = 10e6  # of all trials; `make demo` needs 1 % of it [assumed]


def shortened(trials: Sequence[Trial], model: StepModel) -> tuple[Trial, ...]:
    """Cut trials to the limits, for a model with its longest internal step.

    All trials beyond one length are cut to it, but to 200 rows at least, of which at most a quarter
    are at rest before the motion [assumed].
    """
    cost = len(model.states) * np.array([model.substeps(t.step_s) for t in trials])
    updates = np.minimum(cost * np.array([len(t) for t in trials]), MOST_OF_TRIAL)
    # The limit of a trial w satisfies sum(min(updates, w)) = MOST_OF_ALL.
    sizes = np.sort(updates)
    remaining = MOST_OF_ALL - np.concatenate([[0.0], np.cumsum(sizes)[:-1]])
    limits = remaining / np.arange(len(sizes), 0, -1)
    most = min([*limits[sizes > limits][:1], MOST_OF_TRIAL])
    result = list(trials)
    for k, trial in enumerate(trials):
        rows, rest = max(200, int(most / cost[k])), trial.meta.rest_samples
        start = max(0, rest - rows // 4)
        if rows < len(trial):
            result[k] = with_rows(trial, slice(start, start + rows), rest - start)
    return tuple(result)


def with_rows(trial: Trial, rows: slice, rest_samples: int) -> Trial:
    """Some rows of a trial, of which the first ones are at rest before the motion."""
    meta = msgspec.structs.replace(trial.meta, rest_samples=rest_samples)
    columns = {name: column[rows] for name, column in trial.columns.items()}
    return replace(trial, meta=meta, columns=columns)


# The fit

LARGEST_DERIVATIVE: Final = 1e60  # of a stable simulation; larger squares overflow [assumed]
WORKERS: Final = 2  # threads that simulate; CasADi releases the interpreter lock meanwhile


class SignalFit(NamedTuple):
    """Measured rows of one signal of one trial, at some values of the free parameters."""

    trial: Trial
    signal: str
    part: NDArray[np.int_]  # (n,), see `motion_parts`
    residual: Array  # (n,)
    jacobian: Array  # (n, free)


class Objective:
    """Residuals of a plant over trials, as a function of some parameters.

    `plant` sets the other parameters and the priors of the free ones. Only signals whose names
    start with one of `signals` count. `scale` holds the residual of signals in an earlier fit, in
    their units. The values of `prior` are the centres of the priors (by default, those of `plant`).
    """

    def __init__(
        self,
        plant: Plant,
        kind: ModelKind,
        trials: Sequence[Trial],
        free: Sequence[str],
        signals: Sequence[str],
        scale: Mapping[str, float] | None = None,
        prior: Plant | None = None,
    ) -> None:
        self.plant, self.free = plant, tuple(free)
        self._signals, self._scale = tuple(signals), scale or {}
        self._models: dict[int, CompiledModel] = {}
        used: list[Trial] = []
        for dof in sorted({t.meta.dof for t in trials}):
            model = plant.step_model(dof, kind)
            if kind == "driven":  # An eighth of a period is enough without dry friction.
                model = model.with_substeps(2.2e-3)
            used += shortened([t for t in trials if t.meta.dof == dof], model)
            known = set(names(model.parameters))
            self._models[dof] = CompiledModel(model, [name for name in self.free if name in known])
        self.trials = tuple(used)
        self._measured = [measured_signals(t) for t in used]
        chosen = [plant.parameters[name] for name in self.free]
        self.start = np.array([q.value for q in chosen])
        self.low = np.array([q.low for q in chosen])
        self.high = np.array([q.high for q in chosen])
        self.prior_deviation = np.array([prior_deviation_of(q) for q in chosen])
        self._centre = np.array([(prior or plant).parameters[n].value for n in self.free])
        self._last: tuple[bytes | None, list[SignalFit]] = (None, [])

    def __call__(self, values: Array) -> tuple[Array, Array]:
        """Residuals (n,) and their Jacobian (n, len(free)); those of the priors come last."""
        fits = self._fits(values)
        prior = (values - self._centre) / self.prior_deviation
        residual = np.concatenate([*(f.residual for f in fits), prior])
        jacobian = np.concatenate([*(f.jacobian for f in fits), np.diag(1 / self.prior_deviation)])
        if not (np.abs(jacobian) < LARGEST_DERIVATIVE).all():
            residual = np.full_like(residual, np.inf)  # unstable: the fit must not step here
        return residual, jacobian

    def rms(self, values: Array) -> dict[str, float]:
        """Weighted root mean square residual of each signal, in its unit."""
        squares: dict[str, list[Array]] = defaultdict(list)
        for f in self._fits(values):
            if len(f.residual):
                squares[f.signal].append(f.residual**2 * CORRELATED_SAMPLES)
        return {
            signal: float(np.sqrt(np.mean(np.concatenate(rows)))) * self._scale_of(signal)
            for signal, rows in squares.items()
        }

    def refuse_unstable(self, values: Array) -> None:
        """Refuse a plant whose simulation or its derivatives do not stay finite."""
        if np.isfinite(self(values)[0]).all():
            return
        unstable = {
            str(f.trial.path): None for f in self._fits(values)
            if not np.isfinite(f.residual).all()
            or not (np.abs(f.jacobian) < LARGEST_DERIVATIVE).all()
        }  # fmt: skip
        raise InputError(
            f"plant {self.plant.name!r}",
            f"does not stay finite on {', '.join(unstable) or 'a trial'}",
            "start from other values of its parameters, or check the conditions of the trials",
        )

    def standard_errors(self, values: Array) -> Array:
        """Standard errors at the solution, see `cluster_errors`.

        Rows are grouped by payload (by trial if payloads are few), and by part of the motion.
        """
        fits = self._fits(values)
        loads = [f.trial.meta.payload_kg for f in fits]
        keys = loads if len(set(loads)) >= LEAST_GROUPS else [f.trial.name for f in fits]
        margin = AT_BOUND * (self.high - self.low)
        low, high = self.low - values, self.high - values
        return cluster_errors(
            np.concatenate([f.residual for f in fits]),
            np.concatenate([f.jacobian for f in fits]),
            np.diag(self.prior_deviation**-2.0),
            [
                np.repeat(np.unique(keys, return_inverse=True)[1], [len(f.residual) for f in fits]),
                np.concatenate([f.part for f in fits]),
            ],
            np.where(low > -margin, 0.0, low),
            np.where(high < margin, 0.0, high),
        )

    def _scale_of(self, signal: str) -> float:
        """Scale of a signal's residual, at least `LEAST_SCALE` of its `SCALE`.

        With a smaller scale, a signal that hardly moves (the end effector across a single joint's
        plane) would outweigh all others.
        """
        outputs = (v for compiled in self._models.values() for v in compiled.model.outputs)
        unit = next(v.unit for v in outputs if v.name == signal)
        default = usual_error(unit, [m[signal] for m in self._measured if signal in m])
        return max(self._scale.get(signal, default), LEAST_SCALE.get(unit, 0.5) * default)

    def _fits(self, values: Array) -> list[SignalFit]:
        """Every signal of every trial; the last result is reused."""
        if values.tobytes() != self._last[0]:
            with ThreadPoolExecutor(WORKERS) as pool:
                parts = list(pool.map(lambda k: self._trial(k, values), range(len(self.trials))))
            self._last = (values.tobytes(), [fit for part in parts for fit in part])
        return self._last[1]

    def _trial(self, index: int, values: Array) -> list[SignalFit]:
        trial, measured = self.trials[index], self._measured[index]
        compiled = self._models[trial.meta.dof]
        model = compiled.model
        known = names(model.parameters)
        columns = [self.free.index(name) for name in compiled.wrt]
        p = trial_parameters(model, trial)
        p[[known.index(name) for name in compiled.wrt]] = values[columns]
        y, slopes = differentiate_trial(compiled, trial, p)
        part, fits = motion_parts(trial), []
        for k, signal in enumerate(names(model.outputs)):
            if signal not in measured or not signal.startswith(self._signals):
                continue
            factor = row_weights(trial, signal) / self._scale_of(signal) / CORRELATED_SAMPLES**0.5
            residual = (y[:, k] - measured[signal]) * factor
            jacobian = np.zeros((len(y), len(self.free)))
            jacobian[:, columns] = slopes[:, k] * factor[:, None]
            rows = np.isfinite(measured[signal])
            fits.append(SignalFit(trial, signal, part[rows], residual[rows], jacobian[rows]))
        return fits


class Solution(NamedTuple):
    """Result of a fit."""

    plant: Plant  # With the fitted values and their standard errors
    cost: float  # Half the sum of squares, prior included
    rms: dict[str, float]  # Root mean square residual of each signal, in its unit


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

    low, high = objective.low, objective.high
    margin = 1e-9 * (high - low)
    first = np.clip(objective.start if start is None else start, low + margin, high - margin)
    objective.refuse_unstable(first)
    solution = least_squares(
        residuals, first, lambda values: objective(values)[1], bounds=(low, high), x_scale="jac",
        method="trf", max_nfev=evaluations, ftol=tolerance, xtol=1e-6, gtol=1e-8,
    )  # fmt: skip
    values = np.clip(solution.x, low, high)
    residual, _ = objective(values)
    plant = objective.plant.with_values(
        dict(zip(objective.free, values, strict=True)),
        dict(zip(objective.free, objective.standard_errors(values), strict=True)),
    )
    return Solution(plant, 0.5 * float(residual @ residual), objective.rms(values))


# Standard errors. The curvature of the cost treats residuals as independent noise. But the error of
# a reduced model is alike in rows of one payload, or of one part of the motion, however many they
# are. The fit is therefore repeated, linearised, with one group of rows left out at a time.

LEAST_GROUPS: Final = 3  # whose scatter is used [assumed]


def motion_parts(trial: Trial) -> NDArray[np.int_]:
    """Part of the motion that each row belongs to: signs of angle and rate of the first joint.

    Returns shape (n,), 0 to 3; zeros if no angle or position of the first joint was measured.
    """
    for name in ("angle_1_rad", "position_1_m"):
        if name in trial.columns and len(trial) > 1:
            angle = trial.columns[name] - np.nanmean(trial.columns[name])
            return np.asarray(2 * (angle > 0) + (np.gradient(angle) > 0), dtype=np.int_)
    return np.zeros(len(trial), dtype=int)


def cluster_errors(
    residual: Array,
    jacobian: Array,
    prior: Array,
    groupings: Sequence[NDArray[np.int_]],
    low: Array,
    high: Array,
) -> Array:
    """Standard errors from the curvature and the grouping with the larger variance together.

    Shapes: `residual` (n,), `jacobian` (n, k), the information `prior` (k, k), the group of each
    row in each of `groupings` (n,). `low` and `high` (k,) are the largest changes of each parameter
    down and up, because a refit stays within the bounds. A parameter at a bound (no room on one
    side) is left out of the jackknife and has the error of the curvature alone.

    The delete-a-group jackknife [Efron & Tibshirani 1993]; with few groups the sandwich estimate
    is too small [Cameron & Miller 2015]::

        d_g = (H − H_g)⁻¹ s_g,   H = J'J with priors,  H_g = J_g'J_g,  s_g = J_g'r_g
        V = (G − 1)/G Σ (d_g − mean d)²

    G groups give G − 1 degrees of freedom: the error is widened so that twice the error is a 95 %
    interval of Student's t.
    """
    information = jacobian.T @ jacobian + prior
    curvature = np.diag(np.linalg.pinv(information, hermitian=True))
    free = np.flatnonzero((low < 0) & (high > 0))
    information = information[np.ix_(free, free)]
    largest = np.zeros(len(low))
    for groups in groupings:
        changes = []
        for group in np.unique(groups):
            rows = jacobian[groups == group][:, free]
            score = rows.T @ residual[groups == group]
            change = np.linalg.lstsq(information - rows.T @ rows, score, rcond=1e-12)[0]
            changes.append(np.clip(change, low[free], high[free]))
        count = len(changes)
        if count >= LEAST_GROUPS:
            widened = max(float(student_t.ppf(0.975, count - 1)) / 2.0, 1.0)
            variance = (count - 1) * np.var(changes, axis=0) * widened**2
            largest[free] = np.maximum(largest[free], variance)
    return np.asarray(np.sqrt(curvature + largest))
