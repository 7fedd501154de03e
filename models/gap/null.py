"""What each effect shows where nothing is missing.

The plant's own error looks more like some effects (friction near standstill) than like others, and
more so the more its stiffness and mass differ from those that it was identified with. How much was
measured on laboratories without any hidden effect, their nuisance drawn anew: `null.json`, written
by `python -m bench.gap --calibrate`. An effect is named only beyond that.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from models.plant.plant import LOADS, Plant

PATH: Final = Path(__file__).with_name("null.json")
SHARE: Final = 0.98
"""Share of data sets without an effect on which nothing shall be named."""


@dataclass(frozen=True)
class Null:
    """Distribution of d′ where nothing is missing.

    Attributes
    ----------
    threshold : float
        Least d′, in scatters, of an effect that is named.
    scatter : dict of str to float
        Root mean square of d′ by effect, at least 1; 1 for effects that are not listed.
    """

    threshold: float = 5.0
    scatter: Mapping[str, float] = field(default_factory=dict)

    def price(self, effects: Sequence[str]) -> float:
        """Square of the least d′ that effects must reach together."""
        return sum((self.threshold * self.scatter.get(e, 1.0)) ** 2 for e in effects)


def null_of(plant: Plant) -> Null:
    """Null of a plant: as measured for the link; 5 standard deviations for any other load."""
    if LOADS[plant.load].kind != "link" or not PATH.exists():
        return Null()
    document = json.loads(PATH.read_text(encoding="utf-8"))
    return Null(document["threshold"], document["scatter"])


def calibrate(separations: Sequence[Mapping[str, float]]) -> dict[str, object]:
    """Content of `null.json` from d′ by effect of data sets without any effect."""
    effects = sorted({e for row in separations for e in row})
    scatter = {
        e: max(1.0, float(np.sqrt(np.mean([row.get(e, 0.0) ** 2 for row in separations]))))
        for e in effects
    }
    largest = [max(d / scatter[e] for e, d in row.items()) for row in separations]
    threshold = float(np.quantile(largest, SHARE, method="higher"))
    return {
        "sets": len(separations),
        "threshold": round(threshold, 3),
        "scatter": {e: round(s, 3) for e, s in scatter.items()},
    }
