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
from sklearn.metrics import r2_score
from sklearn.model_selection import LeaveOneGroupOut

from firmware_py.errors import InputError
from models.plant.simulation.runner import CompiledModel
from models.predictor.observed_trials import ObservedTrial, observe
from models.predictor.onnx_graphs import Array
from models.predictor.polynomials import (
    DEGREES,
    ClippedPolynomial,
    Fold,
    GuardedPredictor,
    predict_held_out,
)
from models.predictor.validation import euclidean_distance_m
from models.trials.deformation import deformation_index
from models.trials.trial import Trial, TrialSet

LAG_TICKS: Final = (0, 4, 8, 16)
"""Lags in ticks, up to 0.27 s [assumed]."""
LAGGED_DEGREE: Final = 2
"""Degree of the polynomial in the lagged features."""

Source = Literal["true", "observer", "lagged", "none"]
"""Source of DI: motion capture, the plant observer, the lagged regressor, or none."""


def lagged_features(trial: Trial) -> Array:
    """Angles, then currents at each lag, (n, lags * 2 * dof): the input of `lagged.onnx`.

    The first sample also stands for the time before it.
    """
    signals = np.hstack([trial.angle_rad, trial.current_a])
    row = np.arange(len(signals))
    return np.hstack([signals[np.maximum(row - lag, 0)] for lag in LAG_TICKS])


def fit_lagged(trials: Sequence[Trial]) -> ClippedPolynomial:
    """Fit the lagged regressor to the moving rows whose DI was measured."""
    features = np.vstack([lagged_features(t)[t.moving] for t in trials])
    target = np.concatenate([deformation_index(t)[t.moving] for t in trials])
    measured = np.isfinite(target)
    return ClippedPolynomial.fit(LAGGED_DEGREE, features[measured], target[measured, None])


@dataclass(frozen=True)
class Samples:
    """Moving rows of several trials (512 steps each in the paper), stacked.

    A row without any marker has no measured DI. It is left out for every source, so that all
    predictors are compared on the same rows.
    """

    runs: tuple[ObservedTrial, ...]
    used: tuple[NDArray[np.bool_], ...]  # Rows of each trial that are used
    run: NDArray[np.intp]  # (n,), index of the trial
    time_s: Array  # (n,), time in the trial
    payload_kg: Array
    signals: Array  # (n, 2 * dof), angles and currents
    tip_m: Array  # (n, 3), end effector by motion capture
    di: dict[str, Array]  # (n,) each, DI by source

    def __len__(self) -> int:
        return len(self.run)

    @property
    def trials(self) -> tuple[Trial, ...]:
        return tuple(run.trial for run in self.runs)

    def features(self, source: Source) -> Array:
        """Inputs of a predictor: angles, currents and DI.

        The source "none" leaves the column of DI out, which fits the same functions as the paper's
        DI = 0.
        """
        if source == "none":
            return self.signals
        return np.column_stack([self.signals, self.di[source]])

    def rows_of(self, arrays: Iterable[Array]) -> Array:
        """Used rows of arrays, stacked; one array per trial, with one row per row of the trial."""
        return _stack(arrays, self.used)


def collect_samples(
    trials: TrialSet, observer: CompiledModel, lagged: ClippedPolynomial
) -> Samples:
    """Moving rows of trials with the DI of every source, by payload, phase of joint 2 and name."""
    runs = observe(observer, by_payload(trials))
    used, true = [], [deformation_index(run.trial) for run in runs]
    for (trial, _), di in zip(runs, true, strict=True):
        rows = np.isfinite(di)
        rows[: trial.meta.rest_samples] = False
        if not rows.any():
            raise InputError(
                trial.path, "shows no marker while the link moves", "record the trial again"
            )
        used.append(rows)

    def stacked(column: Callable[[Trial], Array]) -> Array:
        return _stack((column(run.trial) for run in runs), used)

    return Samples(
        runs=tuple(runs),
        used=tuple(used),
        run=np.repeat(np.arange(len(runs)), [rows.sum() for rows in used]),
        time_s=stacked(lambda t: t.time_s),
        payload_kg=stacked(lambda t: np.full(len(t), t.meta.payload_kg)),
        signals=stacked(lambda t: np.hstack([t.angle_rad, t.current_a])),
        tip_m=stacked(lambda t: t.tip_m),
        di={
            "true": _stack(true, used),
            "observer": _stack((run.signals["di"] for run in runs), used),
            "lagged": stacked(lambda t: lagged.predict(lagged_features(t))[:, 0]),
        },
    )


def by_payload(trials: Iterable[Trial]) -> tuple[Trial, ...]:
    """Trials in the order of tables and figures: by payload, phase of joint 2 and name."""
    return tuple(sorted(trials, key=lambda t: (t.meta.payload_kg, t.meta.phase_2_rad, t.name)))


def _stack(arrays: Iterable[Array], used: Sequence[NDArray[np.bool_]]) -> Array:
    return np.concatenate([a[rows] for a, rows in zip(arrays, used, strict=True)])


Folds = dict[str, list[Fold]]
"""Folds by kind: "blocks" of time, and "leave_one_payload_out" if there are several payloads."""


@dataclass(frozen=True)
class Fallback:
    """Fitted polynomial and lagged regressor, and what they were fitted on."""

    predictor: GuardedPredictor
    lagged: ClippedPolynomial
    degree: int
    samples: Samples
    folds: Folds
    observer: CompiledModel  # Observer that estimated the DI

    def r2_of_di(self, tests: Mapping[str, TrialSet]) -> dict[str, float]:
        """R² of the observer's DI on each test; negative if worse than the mean of the DI."""
        r2 = {}
        for name, trials in tests.items():
            di = collect_samples(trials, self.observer, self.lagged).di
            r2[name] = float(r2_score(di["true"], di["observer"]))
        return r2


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
    lagged = fit_lagged(by_payload(training))
    samples = collect_samples(training, observer, lagged)
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
    payload_kg = samples.payload_kg
    if len(np.unique(payload_kg)) > 1:
        splits = LeaveOneGroupOut().split(payload_kg, groups=payload_kg)
        folds["leave_one_payload_out"] = list(splits)
    shortest = min(min(len(train), len(test)) for train, test in folds["blocks"])
    if shortest < samples.signals.shape[1] + 1:
        raise InputError(
            samples.trials[0].path,
            f"{len(samples)} moving rows are too few to hold out five blocks with 1 s gaps",
            "train on runs of at least 4 s",
        )
    return folds


BLOCKS: Final = 5
"""Number of blocks of each run."""
GAP_S: Final = 1.0
"""Time around a block left out whose rows are not used in training [assumed]. Rows 17 ms apart are
nearly equal, so without a gap a block would be tested on its own training data."""


def block_folds(run: NDArray[np.intp], time_s: Array) -> list[Fold]:
    """Folds of five contiguous blocks of each run; `run`, `time_s` (n,)."""
    edges = np.zeros((len(run), BLOCKS + 1))
    for number in np.unique(run):
        rows = run == number
        edges[rows] = np.linspace(time_s[rows].min(), time_s[rows].max(), BLOCKS + 1)
    folds = []
    for block in range(BLOCKS):
        start_s, end_s = edges[:, block], edges[:, block + 1]
        last = block == BLOCKS - 1
        test = (time_s >= start_s) & ((time_s <= end_s) if last else (time_s < end_s))
        train = (time_s <= start_s - GAP_S) | (time_s >= end_s + GAP_S)
        folds.append((np.flatnonzero(train), np.flatnonzero(test)))
    return folds
