"""The published study on any set of trials: every table and figure of the paper, and its findings.

Predictors are trained on trial 1 and tested on trial 2 and on a motion that is not in the
training. Degrees are compared by cross-validation on trial 1 alone; no test trial influences a
choice. The tables of the tests use the paper's plain polynomials. Cross-validation and `deployed`
use the guard that clips inputs into the training box, like the fallback on the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import r2_score
from sklearn.pipeline import Pipeline

from models.predictor.document import summary_of
from models.predictor.fallback import (
    Fallback,
    Folds,
    Samples,
    Source,
    collect_samples,
)
from models.predictor.onnx_graphs import Array
from models.predictor.polynomials import (
    DEGREES,
    GuardedPredictor,
    held_out_errors,
    polynomial_pipeline,
    predict,
)
from models.predictor.validation import axis_coverage, euclidean_distance_m
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
    StudyCurves,
    StudyDocument,
    TipPath,
)
from models.study.findings import judge_findings, payload_key
from models.trials.deformation import deformation_index
from models.trials.trial import Trial, TrialSet

VARIANTS: Final[dict[str, Source]] = {
    "with_di": "true",
    "without_di": "none",
    "estimated_di": "observer",
}
"""The study's three predictors, and the source of DI for the training and tests of each."""
ESTIMATORS: Final[tuple[Source, ...]] = ("observer", "lagged", "none")
ROWS: Final = "moving rows only; the observer also runs through the rest rows in front"
Fitted = Mapping[tuple[Source, int], Pipeline]
"""Fitted pipelines by source of DI and degree."""
Distances = Mapping[tuple[Source, int], Array]
"""Euclidean distance of every row in m, by source of DI and degree."""
Parts = Mapping[str, NDArray[np.bool_]]
"""Rows of each part of a table."""


def run_study(
    fallback: Fallback,
    tests: Mapping[str, TrialSet],
    others: TrialSet | None = None,
    progress: Callable[[str], None] = lambda detail: None,
) -> StudyDocument:
    """Train, cross-validate and test every predictor of the study.

    `fallback`: its training trials are those of the study. `others`: trials of the other dof, for
    the comparison of mean DI.
    """
    samples = fallback.samples
    cross_validation = {
        variant: _cross_validated(samples, source, fallback.folds)
        for variant, source in VARIANTS.items()
    }
    progress("cross-validation")
    fitted: Fitted = {
        (source, degree): polynomial_pipeline(degree).fit(samples.features(source), samples.tip_m)
        for source in ("true", *ESTIMATORS)
        for degree in DEGREES
    }
    tested: dict[str, Samples] = {}
    tables: dict[str, dict[str, Any]] = {}
    error: dict[str, ErrorCurves] = {}
    for name, trials in tests.items():
        tested[name] = collect_samples(trials, fallback.observer, fallback.lagged)
        distances = _distances(tested[name], fitted)
        tables[name] = _tables(tested[name], distances, fallback.predictor)
        error[name] = _error(tested[name], distances)
        progress(name)
    document = StudyDocument(
        schema=StudyDocument.VERSION,
        dof=samples.trials[0].meta.dof,
        rows=ROWS,
        training=summary_of(samples.trials),
        cross_validation=cross_validation,
        mean_di=_mean_di(samples.trials),
        mean_di_other_dof=_mean_di(others or ()),
        chosen_degree=fallback.degree,
        tests={name: summary_of(of_test.trials) for name, of_test in tested.items()},
        series=StudyCurves(
            path=_by_trial(samples, _path),
            di=_by_trial(samples, _di_curve),
            error=error,
            estimates={name: _estimates(of_test) for name, of_test in tested.items()},
        ),
        findings=(),
        **{key: {name: tables[name][key] for name in tests} for key in TABLES},
    )
    repeated = next((of_test.trials for of_test in tested.values()), ())
    findings = judge_findings(document, samples.trials, repeated)
    return msgspec.structs.replace(document, findings=findings)


def _mean_di(trials: Iterable[Trial]) -> dict[str, float]:
    """Mean DI over the moving rows by payload (paper, Fig. 11)."""
    by_key: dict[str, list[Array]] = {}
    for t in sorted(trials, key=lambda t: t.meta.payload_kg):
        by_key.setdefault(payload_key(t.meta.payload_kg), []).append(deformation_index(t)[t.moving])
    return {key: float(np.nanmean(np.concatenate(di))) for key, di in by_key.items()}


def _cross_validated(samples: Samples, source: Source, folds: Folds) -> dict[str, FoldErrors]:
    """Held-out distances by degree.

    With several payloads, those left out choose the degree, because a robot will carry other
    payloads than the trained ones. Blocks of time are reported too: if one block holds the only
    start of a motion, that block alone would decide.
    """
    table, features = {}, samples.features(source)
    for degree in DEGREES:
        entry = {}
        for kind, parts in folds.items():
            error_m = np.vstack(held_out_errors(degree, features, samples.tip_m, parts))
            entry[f"{kind}_m"] = float(np.linalg.norm(error_m, axis=1).mean())
        selection_m = entry.get("leave_one_payload_out_m", entry["blocks_m"])
        table[str(degree)] = FoldErrors(**entry, selection_m=selection_m)
    return table


def _distances(samples: Samples, fitted: Fitted) -> Distances:
    return {
        (source, degree): euclidean_distance_m(
            samples.tip_m, predict(pipeline, samples.features(source))
        )
        for (source, degree), pipeline in fitted.items()
    }


TABLES: Final = ("mean_euclidean_distance_m", "estimators", "baselines", "deployed")
"""Tables of the document with one entry per test."""


def _tables(samples: Samples, distances: Distances, predictor: GuardedPredictor) -> dict[str, Any]:
    """Tables of one set of held-out trials, by their keys in the document."""
    parts = _parts(samples)
    return {
        "mean_euclidean_distance_m": _distance_table(parts, distances),
        "estimators": {source: _estimator(samples, distances, source) for source in ESTIMATORS},
        "baselines": _baselines(samples, parts),
        "deployed": _deployed(samples, parts, predictor),
    }


def _parts(samples: Samples) -> Parts:
    """Rows that are "pooled" (all), of one payload ("0.5"), of one of several phases of joint 2."""
    parts = {"pooled": np.ones(len(samples), dtype=bool)}
    for kg in np.unique(samples.payload_kg):
        parts[payload_key(float(kg))] = samples.payload_kg == kg
    phase_rad = np.array([t.meta.phase_2_rad for t in samples.trials])[samples.run]
    phases = np.unique(phase_rad)
    for phase in phases if len(phases) > 1 else ():
        parts[f"phase_{np.degrees(phase):.0f}deg"] = phase_rad == phase
    return parts


def _distance_table(parts: Parts, distances: Distances) -> DistanceTable:
    """Mean distance by part, variant and degree (paper, eq. 8)."""
    return {
        part: {
            variant: {str(d): float(distances[source, d][rows].mean()) for d in DEGREES}
            for variant, source in VARIANTS.items()
        }
        for part, rows in parts.items()
    }


def _estimator(samples: Samples, distances: Distances, source: Source) -> EstimatorScores:
    true = samples.di["true"]
    estimate = samples.di.get(source, np.zeros_like(true))
    mean_m = {key: float(distance_m.mean()) for key, distance_m in distances.items()}
    fractions: dict[str, float | None] = {}
    for d in DEGREES:
        benefit_m = mean_m["none", d] - mean_m["true", d]
        gained_m = mean_m["none", d] - mean_m[source, d]
        fractions[str(d)] = gained_m / benefit_m if benefit_m > 0 else None
    return EstimatorScores(
        r2_di=float(r2_score(true, estimate)),
        rms_error_di=float(np.sqrt(np.mean((estimate - true) ** 2))),
        mean_euclidean_distance_m={str(d): mean_m[source, d] for d in DEGREES},
        benefit_recovered=fractions,
    )


def _baselines(samples: Samples, parts: Parts) -> BaselineErrors:
    """Distances without a polynomial: the observer's tip, and a link that does not bend."""

    def by_part(tip_m: Array) -> dict[str, float]:
        distance_m = euclidean_distance_m(samples.tip_m, tip_m)
        return {key: float(distance_m[rows].mean()) for key, rows in parts.items()}

    return BaselineErrors(
        observer_tip=by_part(samples.observer_tip_m),
        rigid_kinematics=by_part(samples.rigid_tip_m),
    )


def _deployed(samples: Samples, parts: Parts, predictor: GuardedPredictor) -> DeployedScores:
    """Scores of the fallback with the observer's DI, with guard and 95 % interval."""
    features = samples.features("observer")
    predicted_m, half_width_m = predictor.predict(features), predictor.half_width(features)
    inside = np.abs(samples.tip_m - predicted_m) <= half_width_m
    dof = samples.trials[0].meta.dof
    return DeployedScores(
        mean_euclidean_distance_m=float(euclidean_distance_m(samples.tip_m, predicted_m).mean()),
        interval_coverage=dict(zip("xyz", inside.mean(axis=0).tolist(), strict=True)),
        interval_coverage_mean=axis_coverage(inside, dof).mean,
        interval_coverage_by_part={
            key: axis_coverage(inside[rows], dof).mean for key, rows in parts.items()
        },
        in_range_fraction=float(predictor.in_range(features).mean()),
    )


POINTS: Final = 128  # Largest number of points of a curve: every fourth row of the study's 512


def _by_trial(samples: Samples, curve: Callable[[Samples, int], Any]) -> dict[str, Any]:
    """Curve of each trial by payload, and by phase of joint 2 where the trials differ in it."""
    several, curves = len({t.meta.phase_2_rad for t in samples.trials}) > 1, {}
    for run, t in enumerate(samples.trials):
        phase = f" phase {np.degrees(t.meta.phase_2_rad):.0f}deg" if several else ""
        curves[payload_key(t.meta.payload_kg) + phase] = curve(samples, run)
    return curves


def _heaviest(samples: Samples) -> int:
    return int(np.argmax([t.meta.payload_kg for t in samples.trials]))


def _thin(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """At most `POINTS` of the rows, equally spaced."""
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), POINTS)).round().astype(int)
    return np.asarray(rows[np.unique(chosen)])


def _rounded(values: Array) -> Curve:
    return tuple(float(f"{v:.5g}") for v in values)


def _path(samples: Samples, run: int) -> TipPath:
    trial = samples.trials[run]
    tip_m = trial.tip_m[trial.moving]
    rows = _thin(np.flatnonzero(np.isfinite(tip_m).all(axis=1)))
    return TipPath(*map(_rounded, tip_m[rows].T))


def _di_curve(samples: Samples, run: int) -> DiCurve:
    rows = _thin(np.flatnonzero(samples.run == run))
    angle_1, *angle_2 = map(_rounded, samples.signals[rows, : samples.trials[run].meta.dof].T)
    return DiCurve(
        angle_1_rad=angle_1,
        angle_2_rad=angle_2[0] if angle_2 else None,
        di=_rounded(samples.di["true"][rows]),
    )


def _error(samples: Samples, distances: Distances) -> ErrorCurves:
    runs = [np.flatnonzero(samples.run == run) for run in np.unique(samples.run)]
    grid_s = np.linspace(
        max(samples.time_s[rows[0]] for rows in runs),
        min(samples.time_s[rows[-1]] for rows in runs),
        POINTS,
    )
    curves = {}
    for degree in DEGREES:
        distance_m = distances["true", degree]
        over_runs = [np.interp(grid_s, samples.time_s[rows], distance_m[rows]) for rows in runs]
        curves[str(degree)] = _rounded(np.mean(over_runs, axis=0))
    return ErrorCurves(time_s=_rounded(grid_s - grid_s[0]), euclidean_distance_m=curves)


def _estimates(samples: Samples) -> DiEstimates:
    rows = _thin(np.flatnonzero(samples.run == _heaviest(samples)))
    time_s = samples.time_s[rows]
    curves = {source: _rounded(di[rows]) for source, di in samples.di.items()}
    return DiEstimates(time_s=_rounded(time_s - time_s[0]), **curves)
