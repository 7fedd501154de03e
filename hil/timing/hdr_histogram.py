"""Percentiles of a duration in the text format of HdrHistogram (`.hgrm`).

hdrhistogram.github.io/HdrHistogram/plotFiles.html and similar tools plot such files.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["write_hgrm"]

_TICKS_PER_HALF_DISTANCE: Final = 5
_UNIT_NS: Final = 1_000
"""The file has values in µs."""


def write_hgrm(path: Path, durations_ns: NDArray[np.int64]) -> None:
    """Write the percentiles of durations, shape (n,); without any, the distribution is empty."""
    values = np.sort(np.maximum(durations_ns, 0))
    lines = [
        f"{'Value':>12s} {'Percentile':>14s} {'TotalCount':>10s} {'1/(1-Percentile)':>14s}",
        "",
    ]
    for fraction in _fractions(len(values)):
        # The smallest value that at least this fraction of the durations do not exceed.
        value = values[max(math.ceil(fraction * len(values)) - 1, 0)]
        count = int(np.searchsorted(values, value, side="right"))
        inverse = f" {1 / (1 - fraction):14.2f}" if fraction < 1.0 else ""
        lines.append(f"{value / _UNIT_NS:12.3f} {fraction:2.12f} {count:10d}{inverse}")
    mean, deviation = (values.mean(), values.std()) if len(values) else (0.0, 0.0)
    largest = values[-1] if len(values) else 0
    lines += [
        f"#[Mean    = {mean / _UNIT_NS:12.3f}, StdDeviation   = {deviation / _UNIT_NS:12.3f}]",
        f"#[Max     = {largest / _UNIT_NS:12.3f}, Total count    = {len(values):12d}]",
        f"#[Buckets = {1:12d}, SubBuckets     = {len(values):12d}]",
    ]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _fractions(count: int) -> Iterator[float]:
    """Yield fractions that become denser towards 1: five per halving of the distance to 1."""
    fraction = 0.0
    while count and 1.0 - fraction > 1.0 / count:
        yield fraction
        halvings = int(math.log2(1.0 / (1.0 - fraction)))
        fraction += 1.0 / (_TICKS_PER_HALF_DISTANCE * 2 ** (halvings + 1))
    if count:
        yield 1.0
