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
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import r2_score
from sklearn.model_selection import LeaveOneGroupOut

from firmware_py.core.errors import InputError
from firmware_py.core.signals import tip_names
from models.plant.simulation.runner import CompiledModel
from models.predictor.observed_trials import observe
from models.predictor.onnx_graphs import Array, GraphWriter
from models.predictor.polynomials import (
    DEGREES,
    ClippedPolynomial,
    Fold,
    GuardedPredictor,
    held_out_errors,
)
from models.shared.kinematics import rigid_tip_m
from models.trials.deformation import deformation_index
from models.trials.trial import Trial, TrialSet

LAG_TICKS: Final = (0, 4, 8, 16)  # Lags in ticks, up to 0.27 s [assumed]
LAGGED_DEGREE: Final = 2  # Degree of the polynomial in the lagged features

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

    trials: tuple[Trial, ...]
    run: NDArray[np.intp]  # (n,), index of the trial
    time_s: Array  # (n,), time in the trial
    payload_kg: Array
    signals: Array  # (n, 2 * dof), angles and currents
    tip_m: Array  # (n, 3), end effector by motion capture
    observer_tip_m: Array
    rigid_tip_m: Array  # Of a link that does not bend
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


def by_payload(trials: Iterable[Trial]) -> tuple[Trial, ...]:
    """Trials in the order of tables and figures: by payload, phase of joint 2 and name."""
    return tuple(sorted(trials, key=lambda t: (t.meta.payload_kg, t.meta.phase_2_rad, t.name)))


def collect_samples(
    trials: TrialSet, observer: CompiledModel, lagged: ClippedPolynomial
) -> Samples:
    """Moving rows of trials with the DI of every source."""
    ordered, parts = by_payload(trials), []
    for number, (t, observed) in enumerate(zip(ordered, observe(observer, ordered), strict=True)):
        di = deformation_index(t)
        rows = np.isfinite(di)
        rows[: t.meta.rest_samples] = False
        if not rows.any():
            raise InputError(
                t.path, "shows no marker while the link moves", "record the trial again"
            )
        columns: dict[str, Array] = {
            "run": np.full(len(t), number),
            "time_s": t.time_s,
            "payload_kg": np.full(len(t), t.meta.payload_kg),
            "signals": np.hstack([t.angle_rad, t.current_a]),
            "tip_m": t.tip_m,
            "observer_tip_m": np.column_stack([observed[name] for name in tip_names()]),
            "rigid_tip_m": rigid_tip_m(t.angle_rad, t.meta.base_offset_m, t.meta.link_length_m),
            "true": di,
            "observer": observed["di"],
            "lagged": lagged.predict(lagged_features(t))[:, 0],
        }
        parts.append({name: column[rows] for name, column in columns.items()})
    stacked: dict[str, Any] = {k: np.concatenate([part[k] for part in parts]) for k in parts[0]}
    return Samples(
        trials=ordered,
        di={source: stacked.pop(source) for source in ("true", "observer", "lagged")},
        **stacked,
    )


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

    def write_lagged(self, graph: GraphWriter, source: str) -> None:
        """Write `di`, the result of `lagged.onnx`."""
        self.lagged.write(graph, source, "di_of", "di")

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

    def mean_distance_m(degree: int) -> float:
        error_m = np.vstack(held_out_errors(degree, features, tip_m, chosen))
        return float(np.linalg.norm(error_m, axis=1).mean())

    degree = min(DEGREES, key=mean_distance_m)
    predictor = GuardedPredictor.fit(degree, features, tip_m, chosen)
    progress("fallback")
    return Fallback(predictor, lagged, degree, samples, folds, observer)


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


BLOCKS: Final = 5  # Number of blocks of each run
GAP_S: Final = 1.0
"""Time around a block left out whose rows are not used in training [assumed]. Rows 17 ms apart are
nearly equal, so without a gap a block would be tested on its training data."""


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
