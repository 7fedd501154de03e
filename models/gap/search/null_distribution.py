"""What each effect seems to explain where nothing is missing.

The plant's own error looks more like some effects than like others. How much was measured on
laboratories without any hidden effect, their nuisance drawn anew: `null_distribution.json`,
written by `python -m bench.gap.calibrate`. An effect is named only beyond that.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from models.plant.plant import Plant

PATH: Final = Path(__file__).with_name("null_distribution.json")
SHARE: Final = 0.98
"""Share of data sets without an effect on which nothing shall be named."""
FARTHEST: Final = 4.0
"""Standard deviations of the logarithm, over data sets without an effect, up to which a residual
counts as noise: a link with little damping is fitted much worse than others."""
LEAST_EXPLAINED: Final = 2.0
"""Least such limit: that of 190 data sets without an effect, the calibration's 40 among them. These
alone gave 1.7, and 4 of the other 150 lay above 1.5."""
LEAST: Final = 4.5
"""Least threshold. At 4.0, which Gaussian scatter of 25 effects would pass in one of 500 data sets,
4 of 105 without an effect were given a name, at 4.25, 4.43, 4.47 and 7.5; of 66 hidden effects none
was named below 4.5."""


@dataclass(frozen=True)
class NullDistribution:
    """Distribution of d′ where nothing is missing.

    Attributes
    ----------
    threshold : float
        Least d′, in scatters, of an effect that is named.
    explained : float
        Mean squared residual, in noise floors, up to which nothing counts as left.
    scatter : dict of str to float
        Root mean square of d′ by effect, at least 1; 1 for effects that are not listed.
    """

    threshold: float = 5.0
    explained: float = 1.6
    scatter: Mapping[str, float] = field(default_factory=dict)

    def least(self, effects: Sequence[str]) -> float:
        """Least d′ that effects must reach together."""
        squares = sum(self.scatter.get(e, 1.0) ** 2 for e in effects)
        return self.threshold * float(np.sqrt(squares))


def null_distribution_of(plant: Plant) -> NullDistribution:
    """Null of a plant: as measured for the link, five standard deviations for any other load."""
    if plant.load != "link" or not PATH.exists():
        return NullDistribution()
    document = json.loads(PATH.read_text(encoding="utf-8"))
    return NullDistribution(document["threshold"], document["explained"], document["scatter"])


def calibrated_null_distribution(
    separations: Sequence[Mapping[str, float]], left: Sequence[float]
) -> dict[str, Any]:
    """Content of `null_distribution.json`.

    Parameters
    ----------
    separations : sequence of mapping
        d′ by effect on each data set without an effect.
    left : sequence of float
        Mean squared residual of each, in noise floors.
    """
    effects = sorted({e for row in separations for e in row})
    scatter = {
        e: max(1.0, float(np.sqrt(np.mean([row.get(e, 0.0) ** 2 for row in separations]))))
        for e in effects
    }
    largest = [max(d / scatter[e] for e, d in row.items()) for row in separations]
    threshold = max(LEAST, float(np.quantile(largest, SHARE, method="higher")))
    return {
        "sets": len(separations),
        "threshold": round(threshold, 3),
        "explained": round(max(LEAST_EXPLAINED, _limit(np.log(left))), 3),
        "scatter": {e: round(s, 3) for e, s in scatter.items()},
    }


def _limit(logarithms: Any) -> float:
    return float(np.exp(np.mean(logarithms) + FARTHEST * np.std(logarithms)))
