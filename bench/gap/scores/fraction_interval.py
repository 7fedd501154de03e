"""Fractions with their Clopper-Pearson 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scipy.stats import beta


def clopper_pearson(count: int, total: int) -> tuple[float, float]:
    """Clopper-Pearson 95 % interval of a fraction."""
    low = beta.ppf(0.025, count, total - count + 1) if count else 0.0
    high = beta.ppf(0.975, count + 1, total - count) if count < total else 1.0
    return float(low), float(high)


def fraction_with_interval(rows: Sequence[bool]) -> dict[str, Any]:
    """Fraction of true rows, with its interval."""
    if not rows:
        return {"of": 0}
    low, high = clopper_pearson(sum(rows), len(rows))
    return {"fraction": sum(rows) / len(rows), "interval": [low, high], "of": len(rows)}
