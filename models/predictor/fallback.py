"""Predictor of a robot without the observer: the paper's polynomial with an estimate of DI.

The polynomial of angles, currents and Deformation Index (DI) is trained on the observer's DI. Its
degree is chosen on payloads left out of training. Without the observer the robot's DI comes from
the lagged regressor, a quadratic in angles and currents now and up to 16 ticks (0.27 s) ago. On the
motion that it was trained on it recovers most of the benefit of DI, on others less
(docs/sources.md, "DI without motion capture"), so a bundle is completed by the observer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from sklearn.pipeline import Pipeline

from firmware_py.errors import InputError
from models.plant.simulation.runner import CompiledModel
from models.predictor.observed_trials import ObservedTrial, observe
from models.predictor.onnx_graphs import Array, GraphWriter
from models.predictor.polynomials import (
    DEGREES,
    Fold,
    GuardedPredictor,
    Polynomial,
    polynomial_pipeline,
    predict,
    predict_held_out,
)
from models.predictor.validation import (
    block_folds,
    euclidean_distance_m,
    payload_folds,
    r_squared,
)
from models.trials.deformation import deformation_index
from models.trials.trial import Trial, TrialSet

LAG_TICKS: Final = (0, 4, 8, 16)
"""Lags in ticks, up to 0.27 s [assumed]."""
LAGGED_DEGREE: Final = 2
"""Degree of the polynomial in the lagged features."""

Source = Literal["true", "observer", "lagged", "none"]
"""Source of DI: motion capture, the plant observer, the lagged regressor, or none."""


def lagged_features(
    angle_rad: Array, current_a: Array, lag_ticks: Sequence[int] = LAG_TICKS
) -> Array:
    """Angles and currents at several lags as columns, the input of `lagged.onnx`.

    The run must begin with its first sample, which also stands for the time before it. Returns
    shape (n, len(lag_ticks) * 2 * dof): for each lag angles, then currents.

    Shapes: `angle_rad`, `current_a` (n, dof).
    """
    signals = np.hstack([angle_rad, current_a])
    row = np.arange(len(signals))
    return np.hstack([signals[np.maximum(row - lag, 0)] for lag in lag_ticks])


@dataclass(frozen=True)
class LaggedRegressor:
    """Fitted lagged regressor."""

    pipeline: Pipeline  # Quadratic in the lagged features, with the output DI
    lower: Array  # Training box in SI units; inputs are clipped to it
    upper: Array

    @classmethod
    def fit(cls, trials: Sequence[Trial], di: Sequence[Array]) -> LaggedRegressor:
        """Fit on the moving rows of trials whose DI is known; rows whose `di` is NaN are left out.

        `di`: measured DI of every row of each trial.
        """
        features = np.vstack([lagged_features(t.angle_rad, t.current_a)[t.moving] for t in trials])
        target = np.concatenate([d[t.moving] for t, d in zip(trials, di, strict=True)])
        seen = np.isfinite(target)
        features, target = features[seen], target[seen, None]
        pipeline = polynomial_pipeline(LAGGED_DEGREE).fit(features, target)
        return cls(pipeline, features.min(axis=0), features.max(axis=0))

    def estimate(self, trial: Trial) -> Array:
        """Estimated DI of every row of a trial, shape (n,)."""
        features = lagged_features(trial.angle_rad, trial.current_a)
        return predict(self.pipeline, np.clip(features, self.lower, self.upper))[:, 0]

    def write_graph(self, graph: GraphWriter, source: str) -> None:
        """Write `di`, the result of `lagged.onnx`."""
        clipped = graph.clipped(source, self.lower, self.upper)
        Polynomial.of(self.pipeline).write(graph, clipped, "di_of", "di")


@dataclass(frozen=True)
class Samples:
    """Moving rows of several trials (512 steps each in the paper), stacked.

    A row without any marker has no measured DI. It is left out for every source, so that all
    predictors are compared on the same rows.
    """

    trials: tuple[Trial, ...]
    used: tuple[NDArray[np.bool_], ...]  # Rows of each trial that are used
    run: NDArray[np.intp]  # (n,), index of the trial in `trials`
    time_s: Array  # (n,), time in the trial
    payload_kg: Array
    signals: Array  # (n, 2 * dof), angles and currents
    tip_m: Array  # (n, 3), end effector by motion capture
    di: dict[str, Array]  # (n,) each, DI by source

    def __len__(self) -> int:
        return len(self.run)

    def features(self, source: Source) -> Array:
        """Inputs of a predictor: angles, currents and DI.

        The source "none" leaves the column of DI out, which fits the same functions as the paper's
        DI = 0.
        """
        if source == "none":
            return self.signals
        return np.column_stack([self.signals, self.di[source]])

    def rows_of(self, arrays: Sequence[Array]) -> Array:
        """Used rows of arrays, stacked; one array per trial, with one row per row of the trial."""
        return _stack(arrays, self.used)

    @property
    def angle_rad(self) -> Array:
        """Joint angles, shape (n, dof)."""
        return self.signals[:, : self.signals.shape[1] // 2]


def collect_samples(trials: Sequence[Trial], di: Mapping[str, Sequence[Array]]) -> Samples:
    """Stack the moving rows of trials.

    `di`: by source, DI of every row of each trial, rest rows included; must contain "true".
    """
    used = []
    for trial, true in zip(trials, di["true"], strict=True):
        rows = np.isfinite(true)
        rows[: trial.meta.rest_samples] = False
        if not rows.any():
            raise InputError(
                trial.path, "shows no marker while the link moves", "record the trial again"
            )
        used.append(rows)
    return Samples(
        tuple(trials),
        tuple(used),
        np.concatenate([np.full(int(rows.sum()), i) for i, rows in enumerate(used)]),
        _stack([t.time_s for t in trials], used),
        _stack([np.full(len(t), t.meta.payload_kg) for t in trials], used),
        _stack([np.hstack([t.angle_rad, t.current_a]) for t in trials], used),
        _stack([t.tip_m for t in trials], used),
        {source: _stack(arrays, used) for source, arrays in di.items()},
    )


def _stack(arrays: Sequence[Array], used: Sequence[NDArray[np.bool_]]) -> Array:
    return np.concatenate([a[rows] for a, rows in zip(arrays, used, strict=True)])


Folds = dict[str, list[Fold]]
"""Folds by kind: "blocks" of time, and "leave_one_payload_out" if there are several payloads."""


@dataclass(frozen=True)
class Fallback:
    """Fitted polynomial and lagged regressor, and what they were fitted on."""

    predictor: GuardedPredictor
    lagged: LaggedRegressor
    degree: int
    samples: Samples
    folds: Folds
    observer: CompiledModel  # Observer that estimated the DI

    def r2_of_di(self, tests: Mapping[str, TrialSet]) -> dict[str, float]:
        """R² of the observer's DI on each test."""
        return {
            name: r_squared(samples.di["true"], samples.di["observer"])
            for name, trials in tests.items()
            for samples, _ in [observed_samples(trials, self.observer, self.lagged)]
        }


def doubts_of_di(r2: Mapping[str, float]) -> list[str]:
    """Warning if the observer's DI estimates worse than its mean; one sentence or none."""
    worst = min(r2, key=r2.__getitem__, default="")
    if not worst or not r2[worst] < 0.0:
        return []
    return [
        f"R² of the estimated DI is {r2[worst]:.3f} on {worst}: the mean of the DI would be a "
        "better estimate, so the plant does not bend as the link of these trials; check their "
        "payloads and sizes ('dropstitch validate') and identify the plant on them"
    ]


def fit_fallback(
    training: TrialSet,
    observer: CompiledModel,
    progress: Callable[[str], None] = lambda detail: None,
) -> Fallback:
    """Fit both; the robot's next run is a whole one, so whole runs are left out for the choice.

    Blocks of time would be too optimistic: a predictor trained on the start of every motion never
    has to extrapolate to it. They are used if all trials have one payload.
    """
    trials = by_payload(training)
    lagged = LaggedRegressor.fit(tuple(trials), [deformation_index(t) for t in trials])
    samples, _ = observed_samples(trials, observer, lagged)
    progress("DI")
    folds = _folds(samples)
    chosen = folds.get("leave_one_payload_out", folds["blocks"])
    features, tip_m = samples.features("observer"), samples.tip_m

    def error_m(degree: int) -> float:
        return float(np.mean(np.concatenate(held_out_distances_m(degree, features, tip_m, chosen))))

    degree = min(DEGREES, key=error_m)
    predictor = GuardedPredictor.fit(degree, features, tip_m, chosen)
    progress("fallback")
    return Fallback(predictor, lagged, degree, samples, folds, observer)


def by_payload(trials: TrialSet) -> TrialSet:
    """Trials in the order of tables and figures: by payload, phase of joint 2 and name."""
    return TrialSet(
        tuple(sorted(trials, key=lambda t: (t.meta.payload_kg, t.meta.phase_2_rad, t.name)))
    )


def observed_samples(
    trials: Iterable[Trial], observer: CompiledModel, lagged: LaggedRegressor
) -> tuple[Samples, list[ObservedTrial]]:
    """Rows of trials with the DI of every source, and the trials with the observer's output."""
    trials = tuple(trials)
    runs = observe(observer, trials)
    di = {
        "true": [deformation_index(t) for t in trials],
        "observer": [run.signals["di"] for run in runs],
        "lagged": [lagged.estimate(t) for t in trials],
    }
    return collect_samples(trials, di), runs


def held_out_distances_m(
    degree: int, features: Array, tip_m: Array, folds: Sequence[Fold]
) -> list[Array]:
    """Distance of every row that a fold leaves out, by fold."""
    return [
        euclidean_distance_m(tip_m[fold[1]], predict_held_out(degree, features, tip_m, fold))
        for fold in folds
    ]


def _folds(samples: Samples) -> Folds:
    folds = {"blocks": block_folds(samples.run, samples.time_s)}
    if len(np.unique(samples.payload_kg)) > 1:
        folds["leave_one_payload_out"] = payload_folds(samples.payload_kg)
    shortest = min(min(len(train), len(test)) for train, test in folds["blocks"])
    if shortest < samples.signals.shape[1] + 1:
        raise InputError(
            samples.trials[0].path,
            f"{len(samples)} moving rows are too few to hold out five blocks with 1 s gaps",
            "train on runs of at least 4 s",
        )
    return folds
