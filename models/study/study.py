"""Tables of a study on one set of held-out trials.

Curves of the paper's figures 7 to 13, thinned and rounded to keep `study.json` small.

Published study on any set of trials: training, cross-validation and tests of all predictors.

Predictors are trained on trial 1 and tested on trial 2 and on a motion that is not in the
training. Degrees are compared by cross-validation on trial 1 alone; no test trial influences a
choice. The tables of the tests use the paper's plain polynomials. Cross-validation and
`deployed` use the guard that clips inputs into the training box, like the predictor on the robot.

Summary of a study for the console: figures of each test, and warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from sklearn.pipeline import Pipeline

from firmware_py.display_units import FRACTION, LENGTH
from firmware_py.errors import InputError
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import StepModel
from models.predictor.lagged import LaggedRegressor
from models.predictor.observed_trials import ObserverRun, run_observer
from models.predictor.polynomials import (
    DEGREES,
    Array,
    Fold,
    GuardedPredictor,
    polynomial_pipeline,
    predict,
    predict_held_out,
)
from models.predictor.validation import (
    VARIANTS,
    Samples,
    Source,
    axis_coverage,
    block_folds,
    collect_samples,
    euclidean_distance_m,
    payload_folds,
    payload_key,
    r_squared,
)
from models.shared.kinematics import base_rotation, rigid_tip_m
from models.study.document import (
    BaselineErrors,
    Curve,
    DeployedScores,
    DiCurve,
    DiEstimates,
    DistanceTable,
    ErrorCurves,
    EstimatorScores,
    FoldErrors,
    LinkPoses,
    StudyCurves,
    StudyDocument,
    TipPath,
    TrialsSummary,
)
from models.study.findings import judge_findings
from models.trials.deformation import deformation_index
from models.trials.origin import origins_of
from models.trials.trial import Trial, TrialSet

if TYPE_CHECKING:
    from models.study.document import StudyDocument


ESTIMATORS: Final[tuple[Source, ...]] = ("observer", "lagged", "none")
Fitted = Mapping[tuple[Source, int], Pipeline]
"""Fitted pipelines by source of DI and degree."""
Distances = Mapping[tuple[Source, int], Array]
"""Euclidean distance of every row in m, by source of DI and degree."""


@dataclass(frozen=True)
class StudyTest:
    """Results on one set of held-out trials."""

    samples: Samples
    mean_m: DistanceTable  # Mean of the Euclidean distance over rows
    std_m: DistanceTable  # Its standard deviation
    estimators: dict[str, EstimatorScores]  # By source of DI
    baselines: BaselineErrors  # Distances without a polynomial
    deployed: DeployedScores  # Scores of the robot's predictor


def score_predictors(
    samples: Samples, runs: list[ObserverRun], fitted: Fitted, predictor: GuardedPredictor
) -> StudyTest:
    distances = distances_m(samples, fitted)
    return StudyTest(
        samples=samples,
        mean_m=distance_table(samples, distances, np.mean),
        std_m=distance_table(samples, distances, np.std),
        estimators=estimator_table(samples, distances),
        baselines=baseline_table(samples, runs),
        deployed=deployed_table(predictor, samples),
    )


def distances_m(samples: Samples, fitted: Fitted) -> Distances:
    return {
        (source, degree): euclidean_distance_m(
            samples.tip_m, predict(pipeline, samples.features(source))
        )
        for (source, degree), pipeline in fitted.items()
    }


def distance_table(
    samples: Samples, distances: Distances, statistic: Callable[[Array], Any]
) -> DistanceTable:
    """Statistic of the distances by part, variant and degree (paper, eq. 8)."""
    table: DistanceTable = {}
    for variant, source in VARIANTS.items():
        for degree in DEGREES:
            for key, rows in samples.parts().items():
                by_variant = table.setdefault(key, {}).setdefault(variant, {})
                by_variant[str(degree)] = float(statistic(distances[source, degree][rows]))
    return table


def estimator_table(samples: Samples, distances: Distances) -> dict[str, EstimatorScores]:
    result: dict[str, EstimatorScores] = {}
    true = samples.di["true"]
    for source in ESTIMATORS:
        estimate = samples.di.get(source, np.zeros_like(true))
        errors_m = {str(d): float(distances[source, d].mean()) for d in DEGREES}
        fractions: dict[str, float | None] = {}
        for degree in DEGREES:
            without_m = distances["none", degree].mean()
            benefit_m = without_m - distances["true", degree].mean()
            gained_m = without_m - errors_m[str(degree)]
            fractions[str(degree)] = float(gained_m / benefit_m) if benefit_m > 0 else None
        result[source] = EstimatorScores(
            r2_di=r_squared(true, estimate),
            rms_error_di=float(np.sqrt(np.mean((estimate - true) ** 2))),
            mean_euclidean_distance_m=errors_m,
            benefit_recovered=fractions,
        )
    return result


def baseline_table(samples: Samples, runs: list[ObserverRun]) -> BaselineErrors:
    """Distances without a polynomial: the observer's tip, and a link that does not bend."""
    rigid = [
        rigid_tip_m(t.angle_rad, t.meta.base_offset_m, t.meta.link_length_m) for t in samples.trials
    ]

    def by_part(tips_m: list[Array]) -> dict[str, float]:
        distance_m = euclidean_distance_m(samples.tip_m, samples.rows_of(tips_m))
        return {key: float(distance_m[rows].mean()) for key, rows in samples.parts().items()}

    return BaselineErrors(
        observer_tip=by_part([run.tip_m for run in runs]),
        rigid_kinematics=by_part(rigid),
        final_payload_error_kg={
            trial.name: float(run.payload_kg[-1] - trial.meta.payload_kg)
            for trial, run in zip(samples.trials, runs, strict=True)
        },
    )


def deployed_table(predictor: GuardedPredictor, samples: Samples) -> DeployedScores:
    """Scores of the robot's predictor, with guard and 95 % interval."""
    features = samples.features("observer")
    predicted_m, half_width_m = predictor.predict(features), predictor.half_width(features)
    inside = np.abs(samples.tip_m - predicted_m) <= half_width_m
    dof = samples.trials[0].meta.dof
    axes = list(enumerate("xyz"))
    return DeployedScores(
        mean_euclidean_distance_m=float(euclidean_distance_m(samples.tip_m, predicted_m).mean()),
        interval_coverage={axis: float(inside[:, k].mean()) for k, axis in axes},
        interval_coverage_mean=axis_coverage(inside, dof).mean,
        interval_coverage_by_part={
            key: axis_coverage(inside[rows], dof).mean for key, rows in samples.parts().items()
        },
        mean_half_width_m={axis: float(half_width_m[:, k].mean()) for k, axis in axes},
        in_range_fraction=float(predictor.in_range(features).mean()),
    )


POINTS: Final = 128
"""Largest number of points of a curve: every fourth row of the study's 512."""
POSES: Final = 9
"""Shapes of the link in one cycle: every eighth of it."""


def figure_curves(
    training: Samples,
    tests: Mapping[str, Samples],
    fitted: Fitted,
) -> StudyCurves:
    """Curves that the report draws and no table contains."""
    labels = _labels(training.trials)
    return StudyCurves(
        path=dict(zip(labels, map(_path, training.trials), strict=True)),
        poses=_poses(training, _heaviest(training)),
        di={label: _di_curve(training, run) for run, label in enumerate(labels)},
        error={name: _error(samples, fitted) for name, samples in tests.items()},
        estimates={name: _estimates(samples) for name, samples in tests.items()},
    )


def _labels(trials: Sequence[Trial]) -> list[str]:
    """Label of each trial: payload, and the phase of joint 2 where the trials differ in it."""
    phases = {t.meta.phase_2_rad for t in trials}
    return [
        payload_key(t.meta.payload_kg)
        + (f" phase {np.degrees(t.meta.phase_2_rad):.0f}deg" if len(phases) > 1 else "")
        for t in trials
    ]


def _heaviest(samples: Samples) -> int:
    return max(range(len(samples.trials)), key=lambda i: samples.trials[i].meta.payload_kg)


def _thin(count: int) -> NDArray[np.intp]:
    """At most `POINTS` rows, equally spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, POINTS)).round().astype(int))


def _rounded(values: Array) -> Curve:
    return tuple(float(f"{v:.5g}") for v in values)


def _path(trial: Trial) -> TipPath:
    tip_m = trial.tip_m[trial.moving]
    tip_m = tip_m[np.isfinite(tip_m).all(axis=1)]
    rows = _thin(len(tip_m))
    return TipPath(*(_rounded(tip_m[rows, k]) for k in range(3)))


def _poses(samples: Samples, run: int) -> LinkPoses:
    """Centre line of the link, base plate to tip, at equal times over the first cycle."""
    trial = samples.trials[run]
    start = trial.meta.rest_samples
    end = min(len(trial) - 1, start + round(trial.meta.period_s / trial.step_s))
    rows = np.linspace(start, end, POSES).round().astype(int)
    markers_m = trial.marker_rows_m[rows]
    with np.errstate(invalid="ignore"):  # a row without any marker gives NaN
        centres_m = np.nansum(markers_m, axis=2) / np.isfinite(markers_m).sum(axis=2)
    plate_m = base_rotation(trial.angle_rad[rows])[:, :, 2] * trial.meta.base_offset_m
    line_m = np.concatenate([plate_m[:, None], centres_m], axis=1)
    of_run = samples.run == run
    di = np.interp(trial.time_s[rows], samples.time_s[of_run], samples.di["true"][of_run])
    return LinkPoses(
        payload_kg=trial.meta.payload_kg,
        time_s=_rounded(trial.time_s[rows] - trial.time_s[start]),
        angle_rad=tuple(_rounded(row) for row in trial.angle_rad[rows]),
        di=_rounded(di),
        centre_line_m=tuple(tuple(_point(point) for point in line) for line in line_m),
    )


def _point(coordinates_m: Array) -> tuple[float | None, ...]:
    return tuple(v if np.isfinite(v) else None for v in _rounded(coordinates_m))


def _di_curve(samples: Samples, run: int) -> DiCurve:
    rows = np.flatnonzero(samples.run == run)
    rows = rows[_thin(len(rows))]
    angles = [_rounded(angle_rad) for angle_rad in samples.angle_rad[rows].T]
    return DiCurve(
        angle_1_rad=angles[0],
        angle_2_rad=angles[1] if len(angles) > 1 else None,
        di=_rounded(samples.di["true"][rows]),
    )


def _error(samples: Samples, fitted: Fitted) -> ErrorCurves:
    runs = [np.flatnonzero(samples.run == run) for run in np.unique(samples.run)]
    grid_s = np.linspace(
        max(samples.time_s[rows[0]] for rows in runs),
        min(samples.time_s[rows[-1]] for rows in runs),
        POINTS,
    )
    curves = {}
    for degree in DEGREES:
        distance_m = euclidean_distance_m(
            samples.tip_m, predict(fitted["true", degree], samples.features("true"))
        )
        over_runs = [np.interp(grid_s, samples.time_s[rows], distance_m[rows]) for rows in runs]
        curves[str(degree)] = _rounded(np.mean(over_runs, axis=0))
    return ErrorCurves(time_s=_rounded(grid_s - grid_s[0]), euclidean_distance_m=curves)


def _estimates(samples: Samples) -> DiEstimates:
    rows = np.flatnonzero(samples.run == _heaviest(samples))
    rows = rows[_thin(len(rows))]
    time_s = samples.time_s[rows]
    return DiEstimates(
        time_s=_rounded(time_s - time_s[0]),
        true=_rounded(samples.di["true"][rows]),
        observer=_rounded(samples.di["observer"][rows]),
        lagged=_rounded(samples.di["lagged"][rows]),
    )


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


def study_summary(out: Path, document: StudyDocument) -> str:
    degree = str(document.chosen_degree)
    lines = [f"{out}: degree {degree} by cross-validation on trial 1"]
    for name, table in document.mean_euclidean_distance_m.items():
        pooled, kept = table["pooled"], document.deployed[name]
        r2 = document.estimators[name]["observer"].r2_di
        lines.append(
            f"  {name}: mean Euclidean distance "
            f"{LENGTH.number(pooled['estimated_di'][degree], 2)} mm with "
            f"estimated DI ({LENGTH.number(pooled['with_di'][degree], 2)} with true DI, "
            f"{LENGTH.number(pooled['without_di'][degree], 2)} without), R² of DI {r2:.3f}; "
            f"with inputs kept within the training range "
            f"{LENGTH.number(kept.mean_euclidean_distance_m, 2)} mm: "
            f"{FRACTION.text(kept.in_range_fraction)} of the rows are within it, the interval "
            f"covers {FRACTION.text(kept.interval_coverage_mean)}"
        )
    if not any(name.startswith("trial_") for name in document.tests):
        lines.append("  no trial 2 to test on: simulate with --trials 2")
    if not any(name.startswith("unseen") for name in document.tests):
        lines.append(
            "  no unseen motion: dropstitch simulate --amplitude-deg 20 --trials 1 --out "
            "build/unseen_20deg (with --rig link.toml for your link), then --unseen that directory"
        )
    return "\n".join(lines)
