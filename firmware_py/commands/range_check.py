"""Count of the predictor's measured inputs beyond their training range, during a run.

The graph reports that a tick is out of range, but not why. The watch stands between loop and
predictor. It works only in such ticks, in preallocated memory.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.predictor import NO_SIGNALS, Array, OnnxPredictor, Prediction
from firmware_py.signals import feature_names, unit_of
from firmware_py.summary import InputBeyond, RangeReasons

__all__ = ["RangeWatch"]

_UNBOUNDED: Final = (-np.inf, np.inf)


class RangeWatch:
    """Models of a bundle, with a predictor that records why a tick was out of range."""

    def __init__(self, bundle: ModelBundle) -> None:
        self.estimator, self.predictor = bundle.estimator, self
        self._watched, dof = bundle.predictor, bundle.manifest.dof
        self._names = feature_names(dof)
        ranges = {q.name: (q.minimum, q.maximum) for q in bundle.manifest.features}
        if isinstance(bundle.predictor, OnnxPredictor):
            ranges |= bundle.predictor.ranges
        self._low, self._high = np.transpose([ranges.get(n, _UNBOUNDED) for n in self._names])
        self._row = np.zeros(len(self._names))
        self._angle_rad, self._current_a = self._row[:dof], self._row[dof : 2 * dof]
        self._least, self._most = np.full_like(self._row, np.inf), np.full_like(self._row, -np.inf)
        self._ticks = np.zeros(len(self._names), dtype=np.int64)
        self._other_ticks = 0

    def predict(
        self,
        angle_rad: Array,
        current_a: Array,
        di: float,
        signals: Array = NO_SIGNALS,
        age_s: float = 0.0,
    ) -> Prediction:
        prediction = self._watched.predict(angle_rad, current_a, di, signals, age_s)
        if not prediction.in_range:
            self._note(angle_rad, current_a, di)
        return prediction

    def reasons(self) -> RangeReasons:
        """Return the inputs that were beyond their ranges since the start, and how far."""
        rows = zip(
            self._names, self._ticks.tolist(), self._least.tolist(), self._most.tolist(),
            self._low.tolist(), self._high.tolist(), strict=True,
        )  # fmt: skip
        inputs = tuple(
            InputBeyond(
                name=name, unit=unit_of(name) or "1", ticks=ticks,
                extreme=least if low - least > most - high else most, minimum=low, maximum=high,
            )
            for name, ticks, least, most, low, high in rows
            if ticks
        )  # fmt: skip
        return RangeReasons(inputs=inputs, other_ticks=self._other_ticks)

    def _note(self, angle_rad: Array, current_a: Array, di: float) -> None:
        """Count the inputs beyond their ranges; NaN is not counted."""
        row = self._row
        self._angle_rad[:], self._current_a[:], row[-1] = angle_rad, current_a, di
        finite = np.isfinite(row)
        beyond = finite & ((row < self._low) | (row > self._high))
        self._ticks += beyond
        self._other_ticks += not beyond.any()
        np.minimum(self._least, row, out=self._least, where=finite)
        np.maximum(self._most, row, out=self._most, where=finite)
