"""Null distribution: d′ of each effect where nothing is missing.

The plant's own error resembles some effects more than others. How much was measured on rigs without
any hidden effect, their nuisance drawn anew: `null_distribution.json`, written by
`python -m bench.gap.calibrate`. An effect is named only beyond that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from models.gap.residuals.spectrum import Array
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.plant import Plant

PATH: Final = Path(__file__).with_name("null_distribution.json")


class NullDistribution(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Distribution of d′ where nothing is missing; the content of `null_distribution.json`.

    Attributes
    ----------
    sets : int
        Data sets without an effect that it was measured on.
    threshold : float
        Least d′ of a named effect, in standard deviations of its d′ here.
    explained : float
        Mean squared residual, in noise floors, up to which nothing counts as left.
    standard_deviation : dict of str to float
        Root mean square of d′ by effect, at least 1; 1 for effects that are not listed.
    """

    sets: int = 0
    threshold: float
    explained: float
    standard_deviation: dict[str, float] = {}

    def least(self, effects: Sequence[str]) -> float:
        """Least d′ that effects must reach together.

        Examples
        --------
        >>> null = NullDistribution(
        ...     threshold=5.0, explained=1.6, standard_deviation={"creep": 2.0}
        ... )
        >>> null.least(["creep"]), null.least(["backlash"])
        (10.0, 5.0)
        """
        squares = sum(self.standard_deviation.get(e, 1.0) ** 2 for e in effects)
        return self.threshold * float(np.sqrt(squares))


def null_distribution_of(
    plant: Plant, settings: GapSettings = DEFAULT_SETTINGS
) -> NullDistribution:
    """Null distribution of a plant: as measured for the link, assumed for any other load.

    Parameters
    ----------
    plant : Plant
        As given.
    settings : GapSettings
        Tuned numbers.
    """
    if plant.load != "link" or not PATH.exists():
        return NullDistribution(
            threshold=settings.uncalibrated_threshold,
            explained=settings.uncalibrated_residual_limit,
        )
    return msgspec.json.decode(PATH.read_bytes(), type=NullDistribution)


def calibrated_null_distribution(
    separations: Sequence[Mapping[str, float]],
    left: Sequence[float],
    settings: GapSettings = DEFAULT_SETTINGS,
) -> NullDistribution:
    """Null distribution from data sets without an effect.

    Parameters
    ----------
    separations : sequence of mapping
        d′ by effect on each data set.
    left : sequence of float
        Mean squared residual of each, in noise floors.
    settings : GapSettings
        Tuned numbers.
    """
    effects = sorted({e for row in separations for e in row})
    deviation = {
        e: max(1.0, float(np.sqrt(np.mean([row.get(e, 0.0) ** 2 for row in separations]))))
        for e in effects
    }
    largest = [max(d / deviation[e] for e, d in row.items()) for row in separations]
    quantile = float(np.quantile(largest, settings.null_quantile, method="higher"))
    limit = _limit(np.log(left), settings.residual_limit_log_sd)
    return NullDistribution(
        sets=len(separations),
        threshold=round(max(settings.least_threshold, quantile), 3),
        explained=round(max(settings.least_residual_limit, limit), 3),
        standard_deviation={e: round(s, 3) for e, s in deviation.items()},
    )


def _limit(logarithms: Array, deviations: float) -> float:
    return float(np.exp(np.mean(logarithms) + deviations * np.std(logarithms)))
