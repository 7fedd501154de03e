"""Lagged regressor of DI: an estimate from the servo's measurements, without a model of the link.

It is a quadratic in angles and currents now and up to 16 ticks (0.27 s) ago. On the motion that it
was trained on it recovers most of the benefit of DI, on others less (docs/sources.md, "DI without
motion capture"), so the bundle prefers the plant observer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sklearn.pipeline import Pipeline

from models.predictor.onnx_graphs import PolynomialGraph
from models.predictor.polynomials import Array, polynomial_pipeline, predict
from models.trials.trial import Trial

LAG_TICKS: Final = (0, 4, 8, 16)
"""Lags in ticks, up to 0.27 s [assumed]."""
DEGREE: Final = 2
"""Degree of the polynomial in the lagged features."""


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
        """Fit on the moving rows of trials whose DI is known.

        `di`: true DI of every row of each trial; NaN rows are left out.
        """
        features = np.vstack([lagged_features(t.angle_rad, t.current_a)[t.moving] for t in trials])
        target = np.concatenate([d[t.moving] for t, d in zip(trials, di, strict=True)])
        seen = np.isfinite(target)
        features, target = features[seen], target[seen, None]
        pipeline = polynomial_pipeline(DEGREE).fit(features, target)
        return cls(pipeline, features.min(axis=0), features.max(axis=0))

    def estimate(self, trial: Trial) -> Array:
        """Estimated DI of every row of a trial, shape (n,)."""
        features = lagged_features(trial.angle_rad, trial.current_a)
        return predict(self.pipeline, np.clip(features, self.lower, self.upper))[:, 0]

    @property
    def inputs(self) -> int:
        """Number of inputs of the graph."""
        return len(self.lower)

    def graph(self) -> PolynomialGraph:
        """Model that `to_onnx` converts to `lagged.onnx`."""
        return PolynomialGraph(self.pipeline, "di", (self.lower, self.upper))
