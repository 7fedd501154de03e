"""Percentiles of a duration: count, median, tails and maximum."""

from __future__ import annotations

from typing import Any, Final, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.units import CPU_TIME

__all__ = ["Percentiles"]

Nanoseconds = NDArray[np.int64]

FRACTIONS: Final = {"p50_ns": 0.5, "p99_ns": 0.99, "p99_9_ns": 0.999}
"""Fraction of each percentile, by name of its field."""
LABELS: Final = {"p50": "p50_ns", "p99": "p99_ns", "p99.9": "p99_9_ns", "max": "max_ns"}
"""Field of each label."""


class Percentiles(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Percentiles of a series of durations, each an observed value."""

    n: int  # Number of durations; if it is 0, so are the other fields
    p50_ns: int  # Median
    p99_ns: int  # 99 % of the durations are at most this long
    p99_9_ns: int  # 99.9 % of the durations are at most this long
    max_ns: int  # Longest duration

    @classmethod
    def of(cls, durations_ns: Nanoseconds, **more: Any) -> Self:
        """Return the percentiles of a series of shape (n,)."""
        values = [0] * (len(FRACTIONS) + 1)
        if len(durations_ns):
            levels = (*FRACTIONS.values(), 1.0)
            values = np.quantile(durations_ns, levels, method="inverted_cdf").tolist()
        names = (*FRACTIONS, "max_ns")
        fields = {name: int(value) for name, value in zip(names, values, strict=True)}
        return cls(n=len(durations_ns), **fields, **more)

    def in_us(self) -> str:
        """Return median, tails and maximum in whole µs, as a line of text."""
        return ", ".join(
            f"{label} {CPU_TIME.number(getattr(self, f))} µs" for label, f in LABELS.items()
        )
