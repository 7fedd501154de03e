"""Batch prediction: arrays of measurements to arrays of predictions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.signals import DI, IN_RANGE, PAYLOAD, tip_names
from firmware_py.inference.estimator import DeformationEstimator
from firmware_py.inference.predictor import NO_SIGNALS, OnnxPredictor, Predictor

Array = NDArray[np.float64]


class Predictions(NamedTuple):
    """Predictions of n samples, in arrays that no later call overwrites.

    Attributes
    ----------
    tip_m : ndarray, shape (n, 3)
        End effector in the world frame, in m.
    half_width_m : ndarray, shape (n, 3)
        Half width of the 95 % prediction interval, in m.
    in_range : ndarray of bool, shape (n,)
        Whether every input lies in the range of the training data.
    di : ndarray, shape (n,)
        Deformation Index used for the prediction, dimensionless.
    payload_kg : ndarray, shape (n,)
        Estimated mass at the tip in kg; NaN if it is not estimated.

    Examples
    --------
    >>> import dropstitch
    >>> bundle = dropstitch.ModelBundle.load("docs/notebooks/bundle_1dof")
    >>> predictions = bundle.predict_many([0.0, 0.1], [0.0, 0.2])
    >>> predictions.tip_m.shape, list(predictions.columns())[:2]
    ((2, 3), ['predicted_tip_x_m', 'predicted_tip_y_m'])
    """

    tip_m: Array
    half_width_m: Array
    in_range: NDArray[np.bool_]
    di: Array
    payload_kg: Array

    def __repr__(self) -> str:
        if not len(self.tip_m):
            return "<Predictions of 0 samples>"
        tip_x_m = self.tip_m[:, 0]
        return (
            f"<Predictions of {len(tip_x_m)} samples: tip x {tip_x_m.min():.2f} to "
            f"{tip_x_m.max():.2f} m ± {1e3 * np.mean(self.half_width_m[:, 0]):.0f} mm, "
            f"{np.mean(self.in_range):.0%} in range>"
        )

    def columns(self) -> dict[str, Array | NDArray[np.bool_]]:
        """Return the arrays by their names in the robot's log, for example for `pandas.DataFrame`.

        Returns
        -------
        dict of str to ndarray, shape (n,)
            One column per name; names end in the SI unit.
        """
        return {
            **dict(zip(tip_names("predicted_"), self.tip_m.T, strict=True)),
            **{f"half_width_{axis}_m": self.half_width_m[:, k] for k, axis in enumerate("xyz")},
            IN_RANGE.name: self.in_range,
            DI.name: self.di,
            PAYLOAD.name: self.payload_kg,
        }


def predict_rows(
    predictor: OnnxPredictor, angle_rad: ArrayLike, current_a: ArrayLike, di: ArrayLike, dof: int
) -> Predictions:
    """Predict each row independently, from angle, current and DI.

    Shapes: `angle_rad`, `current_a` (n, dof), `di` (n,) or ().
    """
    if predictor.wanted:
        raise InputError(
            "di", f"is not enough for this predictor, which wants {predictor.wanted[0]}",
            "leave it out: the bundle's estimator then follows the samples",
        )  # fmt: skip
    angle_rad, current_a = _samples(angle_rad, current_a, dof)
    values = _numbers("di", di)
    if values.shape not in ((), (len(angle_rad),)):
        raise InputError(
            "di", f"has the shape {values.shape}", f"give ({len(angle_rad)},) or one number"
        )
    predictions = _empty(len(angle_rad))
    predictions.di[:] = values
    predictions.payload_kg[:] = math.nan
    for k in range(len(angle_rad)):
        _store(predictions, k, predictor, angle_rad[k], current_a[k])
    return predictions


def predict_run(
    estimator: DeformationEstimator,
    predictor: Predictor,
    angle_rad: ArrayLike,
    current_a: ArrayLike,
    step_s: float,
    dof: int,
) -> Predictions:
    """Predict the samples of one run; the estimator tracks its DI from rest at the first row.

    Shapes: `angle_rad`, `current_a` (n, dof), one row per step.
    """
    angle_rad, current_a = _samples(angle_rad, current_a, dof)
    if not 0.0 < step_s < math.inf:
        raise InputError("step_s", f"is {step_s}", "give the time between two rows in s")
    predictions = _empty(len(angle_rad))
    estimator.reset()
    for k in range(len(angle_rad)):
        estimate = estimator.update(angle_rad[k], current_a[k], step_s)
        predictions.di[k], predictions.payload_kg[k] = estimate.di, estimate.payload_kg
        _store(predictions, k, predictor, angle_rad[k], current_a[k], estimate.signals)
    estimator.reset()
    return predictions


def _samples(angle_rad: ArrayLike, current_a: ArrayLike, dof: int) -> tuple[Array, Array]:
    """Check angles and currents and return both with shape (n, dof)."""
    arrays = []
    for name, values in (("angle_rad", angle_rad), ("current_a", current_a)):
        array = _numbers(name, values)
        arrays.append(array[:, None] if array.ndim == 1 and dof == 1 else array)
        if arrays[-1].ndim != 2 or arrays[-1].shape[1] != dof:
            raise InputError(
                name, f"has the shape {array.shape}", f"give (n, {dof}), one row per sample"
            )
    if len(arrays[0]) != len(arrays[1]):
        raise InputError(
            "current_a", f"has {len(arrays[1])} rows, angle_rad {len(arrays[0])}", "give as many"
        )
    return arrays[0], arrays[1]


def _empty(count: int) -> Predictions:
    return Predictions(
        np.empty((count, 3)), np.empty((count, 3)), np.empty(count, dtype=np.bool_),
        np.empty(count), np.empty(count),
    )  # fmt: skip


def _store(
    predictions: Predictions, k: int, predictor: Predictor, angle_rad: Array, current_a: Array,
    signals: Array = NO_SIGNALS,
) -> None:  # fmt: skip
    """Predict row k, whose DI is known, and store the result."""
    answer = predictor.predict(angle_rad, current_a, float(predictions.di[k]), signals)
    predictions.tip_m[k], predictions.half_width_m[k] = answer.tip_m, answer.half_width_m
    predictions.in_range[k] = answer.in_range


def _numbers(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Refuse values that are not finite: they would persist in the estimator's state."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(name, "is no array of numbers", "give one row per sample") from None
    if not np.isfinite(array).all():
        raise InputError(name, "holds values that are not finite", "leave these rows out")
    return array
