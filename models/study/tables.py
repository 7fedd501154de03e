"""Tables of a study on one set of held-out trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from models.learning.predictors import DEGREES, Array, GuardedPredictor, predict
from models.learning.samples import VARIANTS, Samples, Source
from models.learning.validation import euclidean_distance_m, r_squared
from models.shared.kinematics import rigid_tip_m
from models.study.observer_runs import ObserverRun

ESTIMATORS: Final[tuple[Source, ...]] = ("observer", "lagged", "none")
Fitted = Mapping[tuple[Source, int], Any]
"""Fitted pipelines by source of DI and degree."""
Distances = Mapping[tuple[Source, int], Array]
"""Euclidean distance of every row by source of DI and degree, in m."""


def distances_m(samples: Samples, fitted: Fitted) -> dict[tuple[Source, int], Array]:
    """Distances of every predictor on every row (see `Distances`)."""
    return {
        (source, degree): euclidean_distance_m(
            samples.tip_m, predict(pipeline, samples.features(source))
        )
        for (source, degree), pipeline in fitted.items()
    }


def distance_table(
    samples: Samples,
    distances: Distances,
    statistic: Callable[[Array], Any],
) -> dict[str, dict[str, dict[str, float]]]:
    """[pooled | payload][variant][degree] (paper, eq. 8 and Figs. 14 and 15)."""
    table: dict[str, dict[str, dict[str, float]]] = {}
    for variant, source in VARIANTS.items():
        for degree in DEGREES:
            for key, rows in samples.parts().items():
                by_variant = table.setdefault(key, {}).setdefault(variant, {})
                by_variant[str(degree)] = float(statistic(distances[source, degree][rows]))
    return table


def estimator_table(samples: Samples, distances: Distances) -> dict[str, Any]:
    """Each estimator of DI: R², error, and the share of true DI's benefit that it recovers.

    The share is null where true DI itself brings no benefit.
    """
    result: dict[str, Any] = {}
    true = samples.di["true"]
    for source in ESTIMATORS:
        estimate = samples.di.get(source, np.zeros_like(true))
        errors = {str(d): float(distances[source, d].mean()) for d in DEGREES}
        shares: dict[str, float | None] = {}
        for degree in DEGREES:
            without = distances["none", degree].mean()
            benefit = without - distances["true", degree].mean()
            gained = without - errors[str(degree)]
            shares[str(degree)] = float(gained / benefit) if benefit > 0 else None
        result[source] = {
            "r2_di": r_squared(true, estimate),
            "rms_error_di": float(np.sqrt(np.mean((estimate - true) ** 2))),
            "mean_euclidean_distance_m": errors,
            "benefit_recovered": shares,
        }
    return result


def baseline_table(samples: Samples, observations: list[ObserverRun]) -> dict[str, Any]:
    """Distances without a polynomial: the observer's own tip, and a link that does not bend."""
    result: dict[str, Any] = {}
    rigid = [
        rigid_tip_m(t.angle_rad, t.meta.base_offset_m, t.meta.link_length_m) for t in samples.trials
    ]
    for name, tips_m in (
        ("observer_tip", [o.tip_m for o in observations]),
        ("rigid_kinematics", rigid),
    ):
        distance_m = euclidean_distance_m(samples.tip_m, samples.rows_of(tips_m))
        result[name] = {
            key: float(distance_m[rows].mean()) for key, rows in samples.parts().items()
        }
    result["final_payload_error_kg"] = {
        trial.name: float(observation.payload_kg[-1] - trial.meta.payload_kg)
        for trial, observation in zip(samples.trials, observations, strict=True)
    }
    return result


def deployed_table(predictor: GuardedPredictor, samples: Samples) -> dict[str, Any]:
    """Figures of the predictor that the robot gets: guard and 95 % interval included."""
    features = samples.features("observer")
    predicted_m, half_width_m = predictor.predict(features), predictor.half_width(features)
    inside = np.abs(samples.tip_m - predicted_m) <= half_width_m
    axes = list(enumerate("xyz"))
    return {
        "mean_euclidean_distance_m": float(euclidean_distance_m(samples.tip_m, predicted_m).mean()),
        "interval_coverage": {axis: float(inside[:, k].mean()) for k, axis in axes},
        "interval_coverage_mean": float(inside.mean()),
        "interval_coverage_by_part": {
            key: float(inside[rows].mean()) for key, rows in samples.parts().items()
        },
        "mean_half_width_m": {axis: float(half_width_m[:, k].mean()) for k, axis in axes},
        "in_range_share": float(predictor.in_range(features).mean()),
    }
