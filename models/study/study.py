"""Published study on any set of trials: training, cross-validation and tests of all predictors.

Predictors are trained on trial 1 and tested on trial 2 and on a motion that is not in the
training. Degrees are compared by cross-validation on trial 1 alone; no test trial influences a
choice. The tables of the tests use the paper's plain polynomials. Cross-validation and
`deployed` use the guard that clips inputs into the training box, like the predictor on the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np

from firmware_py.errors import InputError
from models.learning.lagged import LaggedRegressor
from models.learning.predictors import (
    DEGREES,
    Array,
    Fold,
    GuardedPredictor,
    polynomial_pipeline,
    predict_held_out,
)
from models.learning.samples import VARIANTS, Samples, collect_samples
from models.learning.validation import block_folds, euclidean_distance_m, payload_folds, payload_key
from models.plant.simulation.compiled_model import CompiledModel
from models.plant.step_model import StepModel
from models.study.figure_curves import figure_curves
from models.study.findings import judge_findings
from models.study.observer_runs import ObserverRun, run_observer
from models.study.study_document import FoldErrors, StudyDocument, TrialsSummary
from models.study.tables import ESTIMATORS, Fitted, StudyTest, score_predictors
from models.trials.deformation import deformation_index
from models.trials.trial import TrialSet
from models.trials.trial_origin import origins_of

__all__ = ["Study", "run_study"]

Folds = dict[str, list[Fold]]
"""Folds by kind: "blocks" of time, and "leave_one_payload_out" if there are several payloads."""

ROWS: Final = "moving rows only; the observer also runs through the rest rows in front"


@dataclass(frozen=True)
class Study:
    """Result of `run_study`."""

    document: StudyDocument
    predictor: GuardedPredictor  # Trained on the observer's DI at the chosen degree
    lagged: LaggedRegressor  # Fallback estimator of DI
    training: Samples  # Rows that both were trained on
    observer: CompiledModel  # Observer that estimated the DI


def run_study(
    training: TrialSet,
    tests: Mapping[str, TrialSet],
    observer: StepModel,
    others: TrialSet | None = None,
    progress: Callable[[str], None] = lambda detail: None,
) -> Study:
    """Train, cross-validate and test every predictor of the study.

    `others`: trials of the other dof, for the comparison of mean DI.
    """
    training, tests = by_payload(training), {k: by_payload(v) for k, v in tests.items()}
    lagged = LaggedRegressor.fit(tuple(training), [deformation_index(t) for t in training])
    compiled = CompiledModel(observer)
    samples, _ = _estimated(training, compiled, lagged)
    progress("DI")
    folds = _folds(samples)
    cross_validation = _cross_validation(samples, folds, progress)
    degree = _best_degree(cross_validation["estimated_di"])
    predictor, fitted = _deployed_predictor(degree, samples, folds), _fit_every_predictor(samples)
    progress("fits")
    results: dict[str, StudyTest] = {}
    for name, trials in tests.items():
        results[name] = score_predictors(*_estimated(trials, compiled, lagged), fitted, predictor)
        progress(name)
    document = StudyDocument(
        schema=StudyDocument.VERSION,
        dof=training[0].meta.dof,
        rows=ROWS,
        training=_summary(training),
        cross_validation=cross_validation,
        mean_di=_mean_di(training),
        mean_di_other_dof=_mean_di(others) if others else {},
        chosen_degree=degree,
        tests={name: _summary(trials) for name, trials in tests.items()},
        mean_euclidean_distance_m={name: r.mean_m for name, r in results.items()},
        std_euclidean_distance_m={name: r.std_m for name, r in results.items()},
        estimators={name: r.estimators for name, r in results.items()},
        baselines={name: r.baselines for name, r in results.items()},
        deployed={name: r.deployed for name, r in results.items()},
        series=figure_curves(samples, {name: r.samples for name, r in results.items()}, fitted),
        findings=(),
    )
    return Study(_with_findings(document, training, tests), predictor, lagged, samples, compiled)


def _with_findings(
    document: StudyDocument, training: TrialSet, tests: Mapping[str, TrialSet]
) -> StudyDocument:
    findings = judge_findings(document, training, tests)
    return msgspec.structs.replace(document, findings=findings)


def by_payload(trials: TrialSet) -> TrialSet:
    """Trials in the order of tables and figures: by payload, phase of joint 2 and name."""
    return TrialSet(
        tuple(sorted(trials, key=lambda t: (t.meta.payload_kg, t.meta.phase_2_rad, t.name)))
    )


def _estimated(
    trials: TrialSet, observer: CompiledModel, lagged: LaggedRegressor
) -> tuple[Samples, list[ObserverRun]]:
    """Rows of trials with DI from every source, and the runs of the observer."""
    runs = [run_observer(observer, t) for t in trials]
    di = {
        "true": [deformation_index(t) for t in trials],
        "observer": [run.di for run in runs],
        "lagged": [lagged.estimate(t) for t in trials],
    }
    return collect_samples(tuple(trials), di), runs


def _fit_every_predictor(samples: Samples) -> Fitted:
    return {
        (source, degree): polynomial_pipeline(degree).fit(samples.features(source), samples.tip_m)
        for source in ("true", *ESTIMATORS)
        for degree in DEGREES
    }


def _deployed_predictor(degree: int, samples: Samples, folds: Folds) -> GuardedPredictor:
    """Fit the robot's predictor; its interval is calibrated on whole runs that are held out.

    The robot's next run is a whole one. Blocks would be too optimistic: a predictor trained on the
    start of every motion never has to extrapolate to it.
    """
    runs = folds.get("leave_one_payload_out", folds["blocks"])
    return GuardedPredictor.fit(degree, samples.features("observer"), samples.tip_m, runs)


def _summary(trials: TrialSet) -> TrialsSummary:
    def values(name: str) -> tuple[float, ...]:
        return tuple(sorted({getattr(t.meta, name) for t in trials}))

    return TrialsSummary(
        trials=tuple(t.name for t in trials),
        sha256=trials.sha256(),
        payload_kg=values("payload_kg"),
        amplitude_rad=values("amplitude_rad"),
        phase_2_rad=values("phase_2_rad"),
        step_s=round(trials[0].step_s, 9),
        origins=origins_of(trials),
    )


def _mean_di(trials: TrialSet) -> dict[str, float]:
    """Mean DI over the moving rows by payload (paper, Fig. 11)."""
    of_payload: dict[str, list[Array]] = {}
    for t in trials:
        moving = deformation_index(t)[t.moving]
        of_payload.setdefault(payload_key(t.meta.payload_kg), []).append(moving)
    return {
        key: float(np.nanmean(np.concatenate(of_payload[key])))
        for key in sorted(of_payload, key=float)
    }


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


def _cross_validation(
    samples: Samples, folds: Folds, progress: Callable[[str], None]
) -> dict[str, dict[str, FoldErrors]]:
    """Held-out distances by variant and degree.

    With several payloads, those left out choose the degree, because a robot will carry other
    payloads than the trained ones. Blocks of time are reported too: if one block holds the only
    start of a motion, that block alone would decide.
    """
    result: dict[str, dict[str, FoldErrors]] = {}
    for variant, source in VARIANTS.items():
        result[variant] = {}
        for degree in DEGREES:
            features = samples.features(source)
            result[variant][str(degree)] = _fold_errors(degree, features, samples.tip_m, folds)
            progress(f"cross-validation {variant} degree {degree}")
    return result


def _fold_errors(degree: int, features: Array, tip_m: Array, folds: Folds) -> FoldErrors:
    mean_m: dict[str, float] = {}
    std_m: dict[str, float] = {}
    for kind, parts in folds.items():
        distances = [
            euclidean_distance_m(tip_m[fold[1]], predict_held_out(degree, features, tip_m, fold))
            for fold in parts
        ]
        mean_m[kind] = float(np.mean(np.concatenate(distances)))
        std_m[kind] = float(np.std([float(d.mean()) for d in distances]))
    return FoldErrors(
        blocks_m=mean_m["blocks"],
        blocks_fold_std_m=std_m["blocks"],
        leave_one_payload_out_m=mean_m.get("leave_one_payload_out"),
        leave_one_payload_out_fold_std_m=std_m.get("leave_one_payload_out"),
        selection_m=mean_m.get("leave_one_payload_out", mean_m["blocks"]),
    )


def _best_degree(by_degree: Mapping[str, FoldErrors]) -> int:
    return int(min(by_degree, key=lambda degree: by_degree[degree].selection_m))
