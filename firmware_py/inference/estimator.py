"""Estimators of the Deformation Index (DI) without motion capture.

`ObserverEstimator` runs the identified plant (an FMU) on the measured angle and current,
`LaggedEstimator` a regression on their recent past. `NoEstimator` returns zero, the study's
baseline without DI.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import ClassVar, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import FmuRefusal, InputError
from firmware_py.core.input_files import Source
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.inference.predictor import NO_SIGNALS, OnnxGraph

Array = NDArray[np.float64]

_LONGEST_STEP_S: Final = 1.7
"""Longest step of the observer after a gap in the data, which bounds its computing time."""
_SHORTEST_STEP_S: Final = 1e-3
"""Shortest step of the observer; time must not run backwards after a jump of the clock."""
_GAP_DECAY_S: Final = 0.3
"""Time constant with which the effect of a gap decays: one swing of the link. [assumed]"""
_NEGLIGIBLE_GAP_S: Final = 1e-6
"""Decayed gap that is set to zero; the tip moves by 0.7 µm in this time at 0.7 rad/s."""
_GAP_TO_AGE: Final = 0.05
"""Fraction of a gap that counts as age once samples arrive again. After 3 slots without data at
0.7 rad/s the error of the observer rose by up to 2.4 mm, while the tip moved by 36 mm."""
_KNOWN_PAYLOAD: Final = "parameters.payload_known_kg"
"""Parameter of the observer FMU; a negative value, its start value, estimates the payload."""


class Estimate(NamedTuple):
    di: float
    payload_kg: float  # Mass at the tip; NaN if it is not estimated
    # Further inputs of the predictor, in its order; overwritten by the next estimate
    signals: Array = NO_SIGNALS


class DeformationEstimator(Protocol):
    """Interface of an estimator of the Deformation Index from the servos' signals.

    Attributes
    ----------
    waits_for_fresh : bool
        Whether it skips ticks without a fresh sample, see `SampleHold`. If False, it gets a sample
        in every tick, repeated if necessary.
    """

    waits_for_fresh: ClassVar[bool]

    def reset(self) -> None:
        """Discard the state: the next sample is the first of a run that starts at rest."""

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        """Process one sample.

        Parameters
        ----------
        angle_rad, current_a : ndarray, shape (dof,)
            Measured angles in rad and currents in A, at the end of the step.
        step_s : float
            Time since the previous sample in s.

        Returns
        -------
        Estimate
            DI and payload at this sample.
        """


class NoEstimator:
    """Estimator that returns DI = 0, the study's baseline "without DI"."""

    waits_for_fresh: ClassVar[bool] = False

    def reset(self) -> None:
        """Do nothing."""

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        return Estimate(0.0, math.nan)


class LaggedEstimator:
    """Regression on angle and current, now and some ticks ago (`lagged.onnx`).

    It ignores the time step, so it is valid only at the period of its training data. Before the
    first sample the link is assumed to have rested at that sample.

    `path`: graph with the input "lagged" (for each lag, angles then currents) and the output "di".
    `lag_ticks`: ages of the samples in ticks, from the manifest.
    """

    waits_for_fresh: ClassVar[bool] = False

    def __init__(self, path: Source, lag_ticks: Sequence[int], dof: int) -> None:
        self._graph = OnnxGraph(path, 2 * dof * len(lag_ticks), (("di", 1),))
        self._input = self._graph.row.reshape(len(lag_ticks), 2 * dof)
        self._history: Array = np.zeros((max(lag_ticks) + 1, 2 * dof))
        self._lags = np.array(lag_ticks)
        self._index = np.zeros_like(self._lags)
        self._dof = dof
        self.reset()

    def reset(self) -> None:
        self._next, self._empty = 0, True

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        history, dof = self._history, self._dof
        row = history if self._empty else history[self._next]
        row[..., :dof] = angle_rad
        row[..., dof:] = current_a
        self._empty = False
        np.subtract(self._next, self._lags, out=self._index)
        np.take(history, self._index, axis=0, out=self._input, mode="wrap")
        self._next = (self._next + 1) % len(history)
        self._graph.run()
        return Estimate(float(self._graph.results[0][0]), math.nan)


class ObserverEstimator:
    """Observer: the identified plant driven by measured angle and current (`observer.fmu`).

    Before the first sample the link is assumed to have rested at that sample.

    `wanted`: outputs beside `di` and `payload_kg`, for `Estimate.signals`.
    """

    waits_for_fresh: ClassVar[bool] = True

    def __init__(
        self,
        fmu: FmuInstance,
        dof: int,
        wanted: Sequence[str] = (),
        further_inputs: Sequence[str] = (),
    ) -> None:
        joints = range(1, dof + 1)
        inputs = [f"angle_{j}_rad" for j in joints] + [f"current_{j}_a" for j in joints]
        self._fmu, self._dof = fmu, dof
        self._tick = fmu.tick_channel([*inputs, *further_inputs], ["di", "payload_kg", *wanted])
        self._signals = self._tick.outputs[2:]
        self._payload_kg: float | None = None
        self._refused = False
        self.reset()

    def assume_payload(self, payload_kg: float | None) -> None:
        """Set the payload as known, or estimate it (None); discard the state."""
        self._payload_kg = payload_kg
        try:
            self.reset()
        except FmuRefusal as refusal:
            raise InputError(
                "payload_kg", f"is {payload_kg}: {str(refusal).rstrip('.')}",
                "correct it, or leave it out to have it estimated",
            ) from None  # fmt: skip

    def reset(self) -> None:
        """Discard the state except for an assumed payload."""
        self._fmu.reset()
        if self._payload_kg is not None:
            self._fmu.set([_KNOWN_PAYLOAD], [self._payload_kg])

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        """Process one sample; see `DeformationEstimator.update`.

        The FMU refuses a sample with NaN and keeps its state; its outputs are then NaN.
        """
        self._set_sample(angle_rad, current_a)
        self._run(step_s)
        outputs = self._tick.outputs
        return Estimate(float(outputs[0]), float(outputs[1]), self._signals)

    def _set_sample(self, angle_rad: Array, current_a: Array) -> None:
        inputs, dof = self._tick.inputs, self._dof
        inputs[:dof] = angle_rad
        inputs[dof : 2 * dof] = current_a

    def _run(self, step_s: float) -> None:
        try:
            self._tick.run(step_s)
        except FmuRefusal:
            self._tick.outputs[:] = math.nan
            self._refused = True
        else:
            self._refused = False


class SampleHold:
    """Estimator for samples from a bus that may fail: the observer waits for fresh ones.

    To the observer, a repeated sample looks like a joint that stopped and then jumped. So it gets
    only fresh samples, each with the time since the previous one, corrected for the delay of the
    samples within their slots. Other estimators count ticks and get a sample in each.
    """

    def __init__(self, estimator: DeformationEstimator) -> None:
        self._estimator = estimator
        self._latest: Estimate | None = None
        self.age_s = self._gap_s = self._stale_s = self._late_s = 0.0
        self._usual_step_s = math.inf

    def reset(self) -> None:
        self._estimator.reset()
        self._latest = None
        self.age_s = self._gap_s = self._stale_s = self._late_s = 0.0

    def update(
        self, angle_rad: Array, current_a: Array, step_s: float, fresh: bool, late_s: float = 0.0
    ) -> Estimate:
        """Process a sample if it is fresh or the first; else return the latest estimate.

        `step_s`: time between the slots of this tick and of the previous one.
        `late_s`: delay of the request for the sample after the begin of the slot.
        """
        latest = self._latest
        if not self._estimator.waits_for_fresh:
            return self._estimator.update(angle_rad, current_a, step_s)
        self._usual_step_s = min(self._usual_step_s, step_s)
        longest_s = max(step_s, _LONGEST_STEP_S)
        slots_s = min(step_s + self._stale_s, longest_s)
        sample_step_s = min(max(slots_s + late_s - self._late_s, _SHORTEST_STEP_S), longest_s)
        if fresh or latest is None:
            self._stale_s, self._late_s = 0.0, late_s
            gap_s = slots_s - self._usual_step_s
            self._gap_s = max(gap_s, self._gap_s * math.exp(-slots_s / _GAP_DECAY_S))
            if self._gap_s < _NEGLIGIBLE_GAP_S:
                self._gap_s = 0.0
            self.age_s = _GAP_TO_AGE * self._gap_s
            self._latest = latest = self._estimator.update(angle_rad, current_a, sample_step_s)
        else:
            self._stale_s = slots_s
            self.age_s = sample_step_s
        return latest


def load_estimator(
    name: str,
    file: Callable[[str], Source],
    dof: int,
    lag_ticks: Sequence[int],
    wanted: Sequence[str] = (),
) -> DeformationEstimator:
    """Load the estimator of a bundle.

    `lag_ticks`: ages of the samples of the lagged estimator, from the manifest.
    `wanted`: further inputs of the predictor that the observer has to provide.
    """
    if name == "observer":
        return ObserverEstimator(FmuInstance(file("observer.fmu")), dof, wanted)
    if name == "lagged":
        return LaggedEstimator(file("lagged.onnx"), lag_ticks, dof)
    if name == "none":
        return NoEstimator()
    raise InputError(
        "manifest.json",
        f"estimator is {name!r}, not 'observer', 'lagged' or 'none'",
        "build the bundle again with this version",
    )
