"""Tables of a study on one set of held-out trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from sklearn.pipeline import Pipeline

from models.learning.axis_coverage import axis_coverage
from models.learning.predictors import DEGREES, Array, GuardedPredictor, predict
from models.learning.samples import VARIANTS, Samples, Source
from models.learning.validation import euclidean_distance_m, r_squared
from models.shared.kinematics import rigid_tip_m
from models.study.observer_runs import ObserverRun
from models.study.study_document import (
    BaselineErrors,
    DeployedScores,
    DistanceTable,
    EstimatorScores,
)

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
