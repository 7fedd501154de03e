"""Predictor of the end effector from measurements and the signals of the estimator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import Source, content_of, limited_memory
from firmware_py.core.signals import AGE, feature_names, observer_signals

Array = NDArray[np.float64]
AXES: Final = 3
MOST_INPUTS: Final = 1000
"""Most input columns of a graph; those of this project have up to 60."""
TRUSTED_M: Final = 0.015
"""Largest half width of the interval of a prediction in range: 1.5 % of the link (requirement)."""
NO_SIGNALS: Final[Array] = np.zeros(0)
"""Signals of an estimator that provides none beside DI and payload."""


class Prediction:
    __slots__ = ("_in_range", "half_width_m", "tip_m")

    def __init__(self, tip_m: Array, in_range: Array, half_width_m: Array) -> None:
        self.tip_m, self._in_range, self.half_width_m = tip_m, in_range, half_width_m

    def copy(self) -> Prediction:
        return Prediction(self.tip_m.copy(), self._in_range.copy(), self.half_width_m.copy())

    @property
    def in_range(self) -> bool:
        """Whether every input is in its training range; False if one is NaN."""
        return bool(self._in_range[0] > 0.5)


class Predictor(Protocol):
    """Interface of a predictor of the end effector."""

    def predict(
        self,
        angle_rad: Array,
        current_a: Array,
        di: float,
        signals: Array = NO_SIGNALS,
        age_s: float = 0.0,
    ) -> Prediction:
        """Predict from one sample.

        Parameters
        ----------
        angle_rad, current_a : ndarray, shape (dof,)
            Measured angles in rad and currents in A; positive current accelerates its joint towards
            positive angles.
        di : float
            Deformation Index, dimensionless.
        signals : ndarray, shape (k,)
            Further signals of the estimate, see `Estimate.signals`.
        age_s : float
            Age of the sample in s, for predictors whose interval widens with it.

        Returns
        -------
        Prediction
            Tip, prediction interval and whether the inputs are in range, in new arrays.
        """


class OnnxGraph:
    """ONNX graph with one float64 input row, run on buffers that are bound once.

    It uses one thread, because only the loop's thread has real-time priority. IO binding on
    preallocated buffers saves 6-7 µs per call and all allocation on the side of Python
    (docs/sources.md, "ONNX").

    `inputs`: required width of the input; None accepts any.
    """

    def __init__(
        self, source: Source, inputs: int | None, outputs: tuple[tuple[str, int], ...]
    ) -> None:
        path, data = content_of(source, "train the bundle again or copy all of it")
        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
        options.log_severity_level = 4  # a damaged file is reported below, in one sentence
        remedy = "train or copy the bundle again"
        try:
            with limited_memory(path, remedy):
                session = ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except InputError:
            raise
        except Exception:  # onnxruntime raises its own types, which differ between versions
            raise InputError(path, "is not a graph that onnxruntime can load", remedy) from None
        actual = [
            (o.name, (o.shape or [0])[-1], o.type)
            for o in (*session.get_inputs(), *session.get_outputs())
        ]
        name, width = actual[0][:2]
        inputs = width if inputs is None and isinstance(width, int) else inputs or 0
        expected = [(name, inputs), *outputs]
        fitting = actual == [(*pair, "tensor(double)") for pair in expected]
        if not fitting or not 0 < inputs <= MOST_INPUTS:
            raise InputError(
                path, f"has the inputs and outputs {actual}, not {expected} in float64",
                "train the bundle again with this version",
            )  # fmt: skip
        self.row: Array = np.zeros(inputs)
        self.results: tuple[Array, ...] = tuple(np.zeros(width) for _, width in outputs)
        try:
            self.metadata: dict[str, str] = session.get_modelmeta().custom_metadata_map
        except UnicodeDecodeError as error:
            raise InputError(path, f"has damaged metadata ({error})", remedy) from None
        self._session = session
        self._binding: Any = session.io_binding()
        self._binding.bind_input(name, "cpu", 0, np.float64, (1, inputs), self.row.ctypes.data)
        for (output, width), buffer in zip(outputs, self.results, strict=True):
            self._binding.bind_output(output, "cpu", 0, np.float64, (1, width), buffer.ctypes.data)
        try:
            with limited_memory(path, remedy):
                self.run()  # the first call allocates inside onnxruntime: before the loop
        except InputError:
            raise
        except Exception as error:
            raise InputError(path, f"cannot be evaluated ({error})", remedy) from None

    def run(self) -> None:
        self._session.run_with_iobinding(self._binding)  # a RunOptions would cost 21 µs


class OnnxPredictor:
    """Predictor from a graph of the bundle, whose metadata name its inputs."""

    def __init__(self, source: Source, dof: int) -> None:
        source = content_of(source, "train the bundle again or copy all of it")
        path = source.path
        outputs = (("tip_m", AXES), ("in_range", 1), ("half_width_m", AXES))
        self._graph = OnnxGraph(source, None, outputs)
        self._prediction = Prediction(*self._graph.results)
        measured, row = feature_names(dof), self._graph.row
        features = _features(self._graph.metadata, path)
        self.ranges = tuple(features)
        self.inputs = tuple(f.name for f in features) or measured
        first, rest = self.inputs[: len(measured)], self.inputs[len(measured) :]
        aged = rest[:1] == (AGE.name,)
        self.wanted = rest[aged:]
        unknown = set(self.wanted) - {signal.name for signal in observer_signals(dof)}
        made_for = self._graph.metadata.get("dof", str(dof))
        if first != measured or unknown or made_for != str(dof) or len(self.inputs) != len(row):
            raise InputError(
                path, f"has the inputs and outputs {', '.join(self.inputs)} of {made_for} joints, "
                f"which a robot of {dof} cannot give", "train the bundle again with this version",
            )  # fmt: skip
        di = len(measured) - 1
        self._angle_rad, self._current_a = row[:dof], row[dof:di]
        self._di, self._signals = row[di : di + 1], row[di + 1 + aged :]
        self._age_s = row[di + 1 : di + 2] if aged else np.zeros(1)

    def predict(
        self,
        angle_rad: Array,
        current_a: Array,
        di: float,
        signals: Array = NO_SIGNALS,
        age_s: float = 0.0,
    ) -> Prediction:
        self._angle_rad[:] = angle_rad
        self._current_a[:] = current_a
        self._di[0] = di
        self._age_s[0] = age_s
        if self.wanted:
            self._signals[:] = signals
        self._graph.run()
        return self._prediction.copy()


class NoPredictor:
    """Predictor that returns a constant tip, 1 m above the base, for benchmarks and tests."""

    def __init__(self) -> None:
        self._prediction = Prediction(np.array([0.0, 0.0, 1.0]), np.ones(1), np.zeros(3))

    def predict(
        self,
        angle_rad: Array,
        current_a: Array,
        di: float,
        signals: Array = NO_SIGNALS,
        age_s: float = 0.0,
    ) -> Prediction:
        return self._prediction


class InputRange(msgspec.Struct, frozen=True):
    """Input column of a graph, from its metadata."""

    name: str
    minimum: float = -math.inf  # In the training data
    maximum: float = math.inf
    # Bounds outside which the graph is out of range, null for none; absent: those of the training
    bounds: tuple[float | None, float | None] | msgspec.UnsetType = msgspec.UNSET

    @property
    def accepted(self) -> tuple[float, float]:
        """Bounds outside which the graph is out of range."""
        if isinstance(self.bounds, msgspec.UnsetType):
            return self.minimum, self.maximum
        low, high = self.bounds
        return -math.inf if low is None else low, math.inf if high is None else high


def named_inputs(metadata: Mapping[str, str], path: Path | str) -> tuple[str, ...]:
    """Return the names of a graph's input columns; empty if its metadata name none.

    `metadata`: the file's `metadata_props`; "features" is a list of objects with a "name".
    """
    return tuple(feature.name for feature in _features(metadata, path))


def _features(metadata: Mapping[str, str], path: Path | str) -> list[InputRange]:
    try:
        return msgspec.json.decode(metadata.get("features", "[]"), type=list[InputRange])
    except msgspec.DecodeError as error:
        raise InputError(
            path, f"names its inputs in damaged metadata ({error})", "train the bundle again"
        ) from None
