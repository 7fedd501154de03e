"""Rates with their Clopper-Pearson 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scipy.stats import binomtest


def rate(rows: Sequence[bool]) -> dict[str, Any]:
    """Fraction of true rows, its interval, and the number of rows."""
    return rate_of_count(sum(rows), len(rows))


def rate_of_count(count: int, of: int) -> dict[str, Any]:
    """The same of a count."""
    if of == 0:
        return {"of": 0}
    low, high = binomtest(count, of).proportion_ci(0.95, method="exact")
    return {"fraction": count / of, "interval": [float(low), float(high)], "of": of}
