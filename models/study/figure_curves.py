"""Curves of the paper's figures 7 to 13, thinned and rounded to keep `study.json` small."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.learning.predictors import DEGREES, Array, predict
from models.learning.samples import Samples
from models.learning.validation import euclidean_distance_m, payload_key
from models.shared.kinematics import base_rotation
from models.study.study_document import (
    Curve,
    DiCurve,
    DiEstimates,
    ErrorCurves,
    LinkPoses,
    StudyCurves,
    TipPath,
)
from models.study.tables import Fitted
from models.trials.trial import Trial

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
