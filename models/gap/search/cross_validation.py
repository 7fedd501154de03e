"""Cross-validation of an effect on trials that its values were not fitted to.

Whole payloads are left out in turn (where there is one, other conditions such as a gain, motions,
or repetitions), and the effects are fitted without them. Only trials that an effect acts on can
test it: a current limit that only the heaviest payload meets is tested on repetitions. Both models
are linear around their fits, which costs no simulation. The nuisance keeps the values of all
trials: extrapolating it to another payload is not tested here. The prior cost of these values
counts once: a turn of the mocap's frame far beyond its prior predicts the held-out trials as well
as the tilt that it stands for. The variation of a held-out trial is fitted to it, within its prior.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.normal_equation import NormalEquation
from models.plant.identification.noise_floor import Array
from models.trials.trial import Trial

FittedModel = tuple[FitPoint, Array]
"""Point where a model was fitted, and its free fit parameters."""

FOLD_KEYS: Final[Mapping[str, Callable[[Trial], object]]] = {
    "payloads": lambda t: t.meta.payload_kg,
    "conditions": lambda t: sorted(t.meta.conditions.items()),
    "motions": lambda t: (t.meta.motion, t.meta.amplitude_rad, t.meta.period_s),
}
"""Property shared by trials that are left out together, by the name of what is left out."""


def held_out_gains(estimator: GaussNewton, without: FittedModel, with_: FittedModel) -> Array:
    """Fall of the cost on each held-out fold, shape (folds,); on the trial itself where there is
    one.
    """
    size = _contributions(estimator, without, with_)
    return np.array(
        [
            _held_out_cost(estimator, *without, fold) - _held_out_cost(estimator, *with_, fold)
            for fold in left_out_folds(
                estimator.residuals.trials, size, estimator.settings.least_block_information
            )
        ]
    )


def held_out_gain(
    estimator: GaussNewton, without: FittedModel, with_: FittedModel
) -> tuple[float, float]:
    """Sum of `held_out_gains` and `nuisance_prior_fall`, and what it must exceed.

    An effect shows more in some payloads than in others, so the variation of the gains between
    folds is no evidence against it: an effect that shows at one payload alone would never exceed
    its standard error, whatever its size. Folds that lose are evidence against it.
    """
    gains = held_out_gains(estimator, without, with_)
    gain = float(gains.sum()) + nuisance_prior_fall(estimator, without, with_)
    return gain, float(np.linalg.norm(np.minimum(gains, 0.0)))


def nuisance_prior_fall(estimator: GaussNewton, without: FittedModel, with_: FittedModel) -> float:
    """Fall of the prior cost of the common nuisance."""
    common = [q.trial is None for q in estimator.residuals.fit_parameters]
    before, after = (np.where(common, point.values, 0.0) for point, _ in (without, with_))
    return 0.5 * float(before @ estimator.prior @ before - after @ estimator.prior @ after)


def left_out_folds(trials: Sequence[Trial], contributions: Array, least: float) -> list[list[int]]:
    """Indices of the trials that are left out together; at least two folds where possible.

    `contributions`, shape (trials,), is the squared change of each trial by the effect, in noise
    floors; `least` is the sum in a fold above which the effect acts on it.
    """
    for key in (*FOLD_KEYS.values(), _repetition):
        keys = [str(key(t)) for t in trials]
        folds = [[i for i, k in enumerate(keys) if k == own] for own in sorted(set(keys))]
        acted_on = [fold for fold in folds if contributions[fold].sum() > least]
        if len(acted_on) > 1:
            return acted_on
    return [[i] for i in range(len(trials))]


def _repetition(trial: Trial) -> object:
    return trial.meta.trial


def _contributions(estimator: GaussNewton, without: FittedModel, with_: FittedModel) -> Array:
    """Squared change of each trial by a candidate, in noise floors, shape (trials,)."""
    (_, before), (point, free) = without, with_
    values = np.where((free != 0) & (before == 0), 0.0, point.values)
    change = [a - b for a, b in zip(estimator.residuals.residuals(values), point.rows, strict=True)]
    result = np.zeros(len(estimator.residuals.trials))
    for group, rows in zip(estimator.residuals.groups, estimator.whiten(change), strict=True):
        for a, k in enumerate(group.trials):
            result[k] += float(np.sum(rows[a] ** 2))
    return result


def _held_out_cost(
    estimator: GaussNewton, point: FitPoint, free: Array, fold: Sequence[int]
) -> float:
    """Cost of the trials of a fold when the effects are fitted without them."""
    estimator.linearise(point, free)
    inside: tuple[list[Array], list[Array]] = ([], [])
    outside: tuple[list[Array], list[Array]] = ([], [])
    white = estimator.whitened(point.rows)
    for group, rows, slopes in zip(estimator.residuals.groups, white, point.slopes, strict=True):
        blocks = slopes.reshape(len(group.trials), -1, slopes.shape[-1])
        for a, k in enumerate(group.trials):
            side = inside if k in fold else outside
            side[0].append(rows[a].ravel())
            side[1].append(blocks[a])
    precision = estimator.precision
    own = np.array([q.trial in fold for q in estimator.residuals.fit_parameters])
    effect = np.array([q.kind == "effect" for q in estimator.residuals.fit_parameters])
    train = np.flatnonzero(free & effect)
    step = np.zeros(len(estimator.residuals.fit_parameters))
    if outside[0]:
        step[train] = _step(estimator, outside, train, point.values)
    left = [
        (r - b @ step, b) for r, b in zip(*inside, strict=True)
    ]  # common fit parameters keep the values of the other trials
    test = np.flatnonzero(free & own)
    parts = ([r for r, _ in left], [b for _, b in left])
    step[test] = _step(estimator, parts, test, point.values)
    after = [r - b[:, test] @ step[test] for r, b in left]
    values = point.values + step
    prior = float(precision[test] @ values[test] ** 2)
    return 0.5 * (sum(float(r @ r) for r in after) + prior)


def _step(
    estimator: GaussNewton,
    parts: tuple[list[Array], list[Array]],
    index: NDArray[np.intp],
    values: Array,
) -> Array:
    """Least-squares step of some fit parameters, including their priors."""
    if not len(index):
        return np.empty(0)
    precision = estimator.precision[index]
    normal = np.diag(precision + 1e-30)
    right = -precision * values[index]
    for r, b in zip(*parts, strict=True):
        normal = normal + b[:, index].T @ b[:, index]
        right = right + b[:, index].T @ r
    ridge = estimator.settings.held_out_ridge_fraction
    return NormalEquation.of(normal).solve(right, ridge)
