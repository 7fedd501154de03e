"""Percentiles of a duration in the text format of HdrHistogram (`.hgrm`).

hdrhistogram.github.io/HdrHistogram/plotFiles.html and its kin draw such files side by side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

_TICKS_PER_HALF_DISTANCE: Final = 5
_UNIT_NS: Final = 1_000
"""Values are written in µs."""


def write_hgrm(path: Path, durations_ns: NDArray[np.int64]) -> None:
    """Write one series; an empty one makes an empty distribution."""
    values = np.sort(np.maximum(durations_ns, 0))
    lines = [
        f"{'Value':>12s} {'Percentile':>14s} {'TotalCount':>10s} {'1/(1-Percentile)':>14s}",
        "",
    ]
    for share in _shares(len(values)):
        # The smallest value that at least this share does not exceed, and how many do not.
        value = values[max(math.ceil(share * len(values)) - 1, 0)]
        count = int(np.searchsorted(values, value, side="right"))
        inverse = f" {1 / (1 - share):14.2f}" if share < 1.0 else ""
        lines.append(f"{value / _UNIT_NS:12.3f} {share:2.12f} {count:10d}{inverse}")
    mean, deviation = (values.mean(), values.std()) if len(values) else (0.0, 0.0)
    largest = values[-1] if len(values) else 0
    lines += [
        f"#[Mean    = {mean / _UNIT_NS:12.3f}, StdDeviation   = {deviation / _UNIT_NS:12.3f}]",
        f"#[Max     = {largest / _UNIT_NS:12.3f}, Total count    = {len(values):12d}]",
        f"#[Buckets = {1:12d}, SubBuckets     = {len(values):12d}]",
    ]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _shares(count: int) -> Iterator[float]:
    """Shares that lie closer and closer together towards 1: five for every halving of the rest."""
    share = 0.0
    while count and 1.0 - share > 1.0 / count:
        yield share
        halvings = int(math.log2(1.0 / (1.0 - share)))
        share += 1.0 / (_TICKS_PER_HALF_DISTANCE * 2 ** (halvings + 1))
    if count:
        yield 1.0
