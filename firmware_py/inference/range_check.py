"""Reasons why predictions were out of range.

The graph reports that a tick is out of range, but not why. `RangeWatch` stands between loop and
predictor and counts the causes during a run; it works only in such ticks, in preallocated memory.
Training counts the same causes over its test trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_py.core.signals import feature_names, unit_of
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.predictor import (
    NO_SIGNALS,
    TRUSTED_M,
    Array,
    InputRange,
    Prediction,
)
from firmware_py.summary import InputBeyond, RangeReasons

_UNBOUNDED: Final = (-np.inf, np.inf)


class RangeCount:
    """Count of the causes over rows that are out of range.

    `ranges`: for each input of a row, in order.
    """

    def __init__(self, ranges: Sequence[InputRange]) -> None:
        self._ranges = tuple(ranges)
        self._low, self._high = np.transpose([r.accepted for r in ranges] or np.zeros((0, 2)))
        # An innovation beyond its bound widens the interval if the joints move, else it is usual.
        self._widens = np.array([r.name.startswith("innovation") for r in ranges], dtype=bool)
        self._least = np.full(len(ranges), np.inf)
        self._most = np.full(len(ranges), -np.inf)
        self._rows = np.zeros(len(ranges), dtype=np.int64)
        self._wide, self._late, self._other, self._widest_m = 0, 0, 0, 0.0

    def add(self, row: Array, half_width_m: Array, age_s: float = 0.0) -> None:
        """Count a row that is out of range; an input that is NaN is not beyond its range."""
        finite = np.isfinite(row)
        beyond = finite & ((row < self._low) | (row > self._high))
        widest_m = float(half_width_m.max())
        wide = widest_m > TRUSTED_M
        if not wide:
            beyond &= ~self._widens
        self._rows += beyond
        np.minimum(self._least, row, out=self._least, where=finite)
        np.maximum(self._most, row, out=self._most, where=finite)
        if beyond.any():
            return
        self._wide += wide
        self._late += wide and float(age_s) > 0.0
        self._other += not wide
        if wide:
            self._widest_m = max(self._widest_m, widest_m)

    def reasons(self) -> RangeReasons:
        """Return the inputs that were beyond their ranges, and how far."""
        inputs = tuple(
            InputBeyond(
                name=known.name, unit=unit_of(known.name) or "1", ticks=int(rows),
                extreme=float(least if low - least > most - high else most),
                minimum=known.minimum, maximum=known.maximum,
            )
            for known, rows, least, most, low, high in zip(
                self._ranges, self._rows, self._least, self._most, self._low, self._high,
                strict=True,
            )
            if rows
        )  # fmt: skip
        return RangeReasons(
            inputs=inputs, wide_ticks=self._wide, late_ticks=self._late, widest_m=self._widest_m,
            other_ticks=self._other,
        )  # fmt: skip


class RangeWatch:
    """Models of a bundle, with a predictor that counts why ticks were out of range."""

    def __init__(self, bundle: ModelBundle) -> None:
        self.estimator, self.predictor = bundle.estimator, self
        self._watched = bundle.predictor
        measured = feature_names(bundle.manifest.dof)
        names = (*measured, *(bundle.signal_names if bundle.ranges else ()))
        self._signals = slice(0, len(names) - len(measured))
        known = {q.name: InputRange(q.name, q.minimum, q.maximum) for q in bundle.manifest.features}
        known |= {r.name: r for r in bundle.ranges}
        ranges = [known.get(name, InputRange(name, *_UNBOUNDED)) for name in names]
        self._count, self._row = RangeCount(ranges), np.zeros(len(names))

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
            row, dof = self._row, len(angle_rad)
            row[:dof], row[dof : 2 * dof], row[2 * dof] = angle_rad, current_a, di
            row[2 * dof + 1 :] = signals[self._signals]
            self._count.add(row, prediction.half_width_m, age_s)
        return prediction

    def reasons(self) -> RangeReasons:
        return self._count.reasons()
