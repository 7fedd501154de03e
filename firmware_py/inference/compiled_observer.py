"""Observer and predictor compiled into one library, which computes a tick in one call."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.signals import AGE, IN_RANGE, tip_names
from firmware_py.inference.estimator import Estimate, ObserverEstimator
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.inference.predictor import NO_SIGNALS, Prediction

Array = NDArray[np.float64]
Runtime = Literal["onnx", "compiled"]
"""What evaluates the predictor: onnxruntime beside the observer, or the observer's own library."""
PREDICTED: Final = (
    *tip_names("predicted_"), IN_RANGE.name, *(f"half_width_{axis}_m" for axis in "xyz")
)  # fmt: skip
"""Outputs of the predictor in the observer's library."""


class CompiledObserver(ObserverEstimator):
    """`DeformationEstimator` and `Predictor` in one: `update` computes both results.

    `predict` returns the prediction for the sample of the latest `update`, and refuses any other
    fresh sample. It computes again only if the age of the sample has changed.
    """

    def __init__(self, fmu: FmuInstance, dof: int) -> None:
        if not self.offered_by(fmu):
            raise InputError(
                fmu.path, "holds no compiled predictor",
                "build it with 'dropstitch fmu build --unit observer' in a checkout, or choose "
                'runtime = "onnx"',
            )  # fmt: skip
        innovations = (f"innovation_{j}_a" for j in range(1, dof + 1))
        self.signal_names = tuple(name for name in innovations if name in fmu.variables)
        aged = [AGE.name] if AGE.name in fmu.variables else []
        super().__init__(fmu, dof, [*PREDICTED, *self.signal_names], aged)
        outputs = self._tick.outputs
        self._prediction = Prediction(outputs[2:5], outputs[5:6], outputs[6:9])
        self._signals = outputs[9:]
        self._age = self._tick.inputs[2 * dof :]

    @staticmethod
    def offered_by(fmu: FmuInstance) -> bool:
        return fmu.ticks and all(name in fmu.variables for name in PREDICTED)

    def reset(self) -> None:
        super().reset()
        self._updated = False

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        self._updated = True
        self._set_age(0.0)
        return super().update(angle_rad, current_a, step_s)

    def predict(
        self,
        angle_rad: Array,
        current_a: Array,
        di: float,
        signals: Array = NO_SIGNALS,
        age_s: float = 0.0,
    ) -> Prediction:
        """Return the prediction for the latest sample; see `Predictor.predict`.

        Before the first `update` the link is assumed to rest at the sample passed here.
        """
        if not self._updated:
            self._set_sample(angle_rad, current_a)
            self._predict_again(age_s)
        elif age_s == 0.0 and not self._refused and not self._had(angle_rad, current_a):
            raise InputError(
                "predict", "is given a sample that update has not had",
                "give the observer every sample, or use ModelBundle.predict_many",
            )  # fmt: skip
        elif age_s != self._known_age_s and not self._refused:
            self._predict_again(age_s)
        return self._prediction.copy()

    def _had(self, angle_rad: Array, current_a: Array) -> bool:
        """Whether the latest `update` had this sample; by items, since NumPy is slower here."""
        inputs, dof = self._tick.inputs, self._dof
        return all(
            inputs[j] == angle_rad[j] and inputs[dof + j] == current_a[j] for j in range(dof)
        )

    def _set_age(self, age_s: float) -> None:
        self._age[:] = self._known_age_s = age_s

    def _predict_again(self, age_s: float) -> None:
        """Predict for another age of the sample, without a step of the observer."""
        self._set_age(age_s)
        self._run(0.0)
