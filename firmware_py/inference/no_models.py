"""Stand-ins for the models of a bundle: DI = 0 and a constant tip, for benchmarks and tests."""

from __future__ import annotations

import numpy as np

from firmware_py.inference.estimator import NoEstimator
from firmware_py.inference.predictor import NO_SIGNALS, Array, Prediction

__all__ = ["NoModels", "NoPredictor"]


class NoPredictor:
    """Predictor that returns a constant tip, 1 m above the base."""

    def __init__(self) -> None:
        self._prediction = Prediction(np.array([0.0, 0.0, 1.0]), np.ones(1), np.zeros(3))

    def predict(
        self,
        angle_rad: Array,
        current_a: Array,
        di: float,
        signals: Array = NO_SIGNALS,
        age_s: float = 0.0,
    ) -> Prediction:
        return self._prediction


class NoModels:
    """Models of a loop that estimates and predicts nothing."""

    def __init__(self) -> None:
        self.estimator, self.predictor = NoEstimator(), NoPredictor()
