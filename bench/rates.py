"""Rates with their Clopper-Pearson 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scipy.stats import binomtest


def rate(rows: Sequence[bool]) -> dict[str, Any]:
    """Fraction of true rows, its interval, and the number of rows."""
    if not rows:
        return {"of": 0}
    low, high = binomtest(sum(rows), len(rows)).proportion_ci(0.95, method="exact")
    interval = [float(low), float(high)]
    return {"fraction": sum(rows) / len(rows), "interval": interval, "of": len(rows)}
