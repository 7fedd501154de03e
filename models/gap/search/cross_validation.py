"""Whether an effect also helps on trials that its values were not fitted to.

Whole payloads are left out in turn (where there is one, other conditions such as a gain, motions,
or repetitions), and the effects fitted without them. Both models are taken as linear around their
fits, which costs no simulation; nuisance stays where all trials put it, for to extrapolate it to
another payload is not the question. The variation of a trial that was left out is fitted to it,
within its spread.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.residuals.spectrum import Array
from models.trials.trial import Trial

FittedModel = tuple[FitPoint, Array]
"""Where a model was fitted, and the knobs that it may turn."""


def held_out_gains(estimator: GaussNewton, without: FittedModel, with_: FittedModel) -> Array:
    """Fall of the cost on each fold that was left out, shape (folds,); with one trial, on that."""
    return np.array(
        [
            _held_out_cost(estimator, *without, fold) - _held_out_cost(estimator, *with_, fold)
            for fold in left_out_folds(estimator.problem.trials)
        ]
    )


def left_out_folds(trials: Sequence[Trial]) -> list[list[int]]:
    """Trials that are left out together."""
    for what in ("payload_kg", "conditions", "motion", "trial"):
        keys = [str(getattr(t.meta, what)) for t in trials]
        if len(set(keys)) > 1:
            return [[i for i, k in enumerate(keys) if k == own] for own in sorted(set(keys))]
    return [[i] for i in range(len(trials))]


def _held_out_cost(
    estimator: GaussNewton, point: FitPoint, free: Array, fold: Sequence[int]
) -> float:
    """Cost of the trials of a fold when the effects are fitted without them."""
    estimator.linearise(point)
    inside: tuple[list[Array], list[Array]] = ([], [])
    outside: tuple[list[Array], list[Array]] = ([], [])
    white = estimator.whitened(point.rows)
    for group, rows, slopes in zip(estimator.problem.groups, white, point.slopes, strict=True):
        blocks = slopes.reshape(len(group.trials), -1, slopes.shape[-1])
        for a, k in enumerate(group.trials):
            side = inside if k in fold else outside
            side[0].append(rows[a].ravel())
            side[1].append(blocks[a])
    precision = estimator.precision
    own = np.array([k.trial in fold for k in estimator.problem.knobs])
    effect = np.array([k.kind == "effect" for k in estimator.problem.knobs])
    train = np.flatnonzero(free & effect)
    step = np.zeros(len(estimator.problem.knobs))
    if outside[0]:
        step[train] = _ridge(outside, train, precision, point.values)
    left = [
        (r - b @ step, b) for r, b in zip(*inside, strict=True)
    ]  # common knobs stand where the others put them
    test = np.flatnonzero(free & own)
    parts = ([r for r, _ in left], [b for _, b in left])
    step[test] = _ridge(parts, test, precision, point.values)
    after = [r - b[:, test] @ step[test] for r, b in left]
    values = point.values + step
    prior = float(precision[test] @ values[test] ** 2)
    return 0.5 * (sum(float(r @ r) for r in after) + prior)


def _ridge(
    parts: tuple[list[Array], list[Array]], index: NDArray[np.intp], precision: Array, values: Array
) -> Array:
    """Least squares step of some knobs, their priors included."""
    if not len(index):
        return np.empty(0)
    normal = np.diag(precision[index] + 1e-30)
    right = -precision[index] * values[index]
    for r, b in zip(*parts, strict=True):
        normal = normal + b[:, index].T @ b[:, index]
        right = right + b[:, index].T @ r
    size = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    scaled = normal / np.outer(size, size) + 1e-9 * np.eye(len(index))
    return np.asarray(np.linalg.solve(scaled, right / size) / size)
