"""Predictor of the end effector from angle, current and Deformation Index."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from firmware_py.errors import InputError

__all__ = ["OnnxGraph", "OnnxPredictor", "Prediction", "Predictor"]

Array = NDArray[np.float64]
AXES: Final = 3


class Prediction:
    """Latest prediction, in buffers that the next call overwrites.

    Attributes
    ----------
    tip_m : ndarray, shape (3,)
        End effector in the world frame, for inputs clipped to the training range.
    half_width_m : ndarray, shape (3,)
        Half width of the 95 % prediction interval; grows outside the training data.
    """

    __slots__ = ("_in_range", "half_width_m", "tip_m")

    def __init__(self, tip_m: Array, in_range: Array, half_width_m: Array) -> None:
        self.tip_m, self._in_range, self.half_width_m = tip_m, in_range, half_width_m

    @property
    def in_range(self) -> bool:
        """Whether every input lay in the training range; False where one was NaN."""
        return bool(self._in_range[0] > 0.5)


class Predictor(Protocol):
    """Interface of a predictor of the end effector."""

    def predict(self, angle_rad: Array, current_a: Array, di: float) -> Prediction:
        """Predict from one sample.

        Parameters
        ----------
        angle_rad, current_a : ndarray, shape (dof,)
            As measured; positive current pushes its angle positive.
        di : float
            Deformation Index, dimensionless.

        Returns
        -------
        Prediction
            Tip and prediction interval; overwritten by the next call.
        """


class OnnxGraph:
    """ONNX graph with one float64 input row, run with buffers that are bound once.

    Parameters
    ----------
    path : Path or str
        ONNX file.
    inputs : int
        Required width of the input.
    outputs : sequence of (name, width)
        Required outputs, in order.

    Attributes
    ----------
    row : ndarray, shape (inputs,)
        Input; write it before `run`.
    results : tuple of ndarray
        Outputs of the latest `run`, shapes (width,).

    Raises
    ------
    InputError
        If the file is missing or damaged, or has other inputs or outputs.

    Notes
    -----
    One thread, because the loop's thread is the one with real-time priority; IO binding on
    preallocated buffers saves 6-7 µs a call and all allocation on our side
    (docs/sources.md, "ONNX").
    """

    def __init__(self, path: Path | str, inputs: int, outputs: tuple[tuple[str, int], ...]) -> None:
        path = Path(path)
        if not path.is_file():
            raise InputError(path, "is missing", "train the bundle again or copy all of it")
        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
        options.log_severity_level = 4  # a damaged file is reported below, in one sentence
        try:
            session = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception:  # onnxruntime raises its own types, which differ between versions
            raise InputError(
                path, "is not a graph that onnxruntime can load", "train or copy the bundle again"
            ) from None
        found = [
            (o.name, o.shape[-1], o.type) for o in (*session.get_inputs(), *session.get_outputs())
        ]
        name = found[0][0]
        expected = [(name, inputs), *outputs]
        if found != [(*pair, "tensor(double)") for pair in expected]:
            raise InputError(
                path, f"has the inputs and outputs {found}, not {expected} in float64",
                "train the bundle again with this version",
            )  # fmt: skip
        self.row: Array = np.zeros(inputs)
        self.results: tuple[Array, ...] = tuple(np.zeros(width) for _, width in outputs)
        self._session = session
        self._binding: Any = session.io_binding()
        self._binding.bind_input(name, "cpu", 0, np.float64, (1, inputs), self.row.ctypes.data)
        for (output, width), buffer in zip(outputs, self.results, strict=True):
            self._binding.bind_output(output, "cpu", 0, np.float64, (1, width), buffer.ctypes.data)
        self.run()  # the first call allocates inside onnxruntime: not in the loop

    def run(self) -> None:
        """Evaluate the graph on `row` into `results`."""
        self._session.run_with_iobinding(self._binding)  # a RunOptions would cost 21 µs


class OnnxPredictor:
    """Predictor from the bundle's `predictor.onnx`.

    Parameters
    ----------
    path : Path or str
        The file.
    dof : int
        Number of joints.

    Raises
    ------
    InputError
        If the file is missing, damaged or made for another number of joints.
    """

    def __init__(self, path: Path | str, dof: int) -> None:
        outputs = (("tip_m", AXES), ("in_range", 1), ("half_width_m", AXES))
        self._graph = OnnxGraph(path, 2 * dof + 1, outputs)
        self._prediction = Prediction(*self._graph.results)
        row = self._graph.row
        self._angle_rad, self._current_a, self._di = row[:dof], row[dof:-1], row[-1:]

    def predict(self, angle_rad: Array, current_a: Array, di: float) -> Prediction:
        """Predict from one sample, without net allocation; see `Predictor.predict`."""
        self._angle_rad[:] = angle_rad
        self._current_a[:] = current_a
        self._di[0] = di
        self._graph.run()
        return self._prediction
