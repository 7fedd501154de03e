"""Pairs of effects, tried where no single effect explains the gap."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.plant.identification.noise_floor import Array

EffectPair = tuple[str, str]


def promising_pairs(
    estimator: GaussNewton,
    here: FitPoint,
    named: Sequence[str],
    effects: Sequence[str],
    free: Callable[[Sequence[str]], Array],
) -> list[tuple[EffectPair, FitPoint]]:
    """Pairs whose derivatives predict the largest fall of the cost, each after one step.

    `free` returns the fit parameters that are fitted with some effects, ndarray of bool.
    """
    rows = []
    for pair in itertools.combinations(effects, 2):
        step, fall = estimator.step(here, free([*named, *pair]))
        rows.append((fall, pair, step))
    rows.sort(key=lambda row: -row[0])
    best = rows[: estimator.settings.refitted_pairs]
    return [(pair, estimator.line_search(here, step) or here) for _, pair, step in best]
