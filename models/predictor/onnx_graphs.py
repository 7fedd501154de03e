"""ONNX graphs of predictors: writer, evaluation of what it writes on arrays, import into CasADi.

A model is written once, as operators. `to_onnx` turns them into the file that the robot loads,
`evaluate` computes the same operators on many rows, and `predictor_function` imports the file for
the twin and predictor FMUs. All graphs are float64, batch 1, opset 13, IR 7, so that onnxruntime
from 1.16 on loads them, and use only operators that CasADi imports (tested).
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np
import onnx
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.signals import feature_names
from firmware_py.inference.predictor import named_inputs

Array = NDArray[np.float64]

OPSET, IR_VERSION = 13, 7
"""Versions of operators and file format that onnxruntime 1.16 and later load."""
ROW: Final = "features"  # Name of the input row of a predictor
OUTPUTS: Final = {"tip_m": 3, "in_range": 1, "half_width_m": 3}
"""Results of a predictor's graph with their widths; `in_range` is 1.0 or 0.0."""


class GraphWriter:
    """Nodes and constants of a graph, under stable, unique names."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []
        self._names: Counter[str] = Counter(OUTPUTS.keys())

    def unique(self, stem: str) -> str:
        """Name that begins with `stem` and that nothing else in the graph has."""
        self._names[stem] += 1
        return stem if self._names[stem] == 1 else f"{stem}_{self._names[stem] - 1}"

    def constant(self, stem: str, value: Array) -> str:
        """Unique name of a new float64 constant."""
        name = self.unique(stem)
        self.constants.append(onnx.numpy_helper.from_array(np.asarray(value, dtype=float), name))
        return name

    def node(self, op: str, inputs: Sequence[str | Array], output: str, **attributes: Any) -> str:
        """Add an operator whose result is called `output`; an array as input becomes a constant."""
        names = [
            x if isinstance(x, str) else self.constant(f"{output}_constant", x) for x in inputs
        ]
        name = self.unique(f"{output}_{op}")
        self.nodes.append(onnx.helper.make_node(op, names, [output], name, **attributes))
        return output

    def temporary(
        self, op: str, inputs: Sequence[str | Array], stem: str, **attributes: Any
    ) -> str:
        """Add an operator whose result gets a unique name."""
        return self.node(op, inputs, self.unique(stem), **attributes)

    def clipped(self, source: str, lower: Array, upper: Array) -> str:
        """Clip a row into a box."""
        raised = self.temporary("Max", [source, lower[None]], "raised")
        return self.temporary("Min", [raised, upper[None]], "clipped")

    def inside(self, source: str, lower: Array, upper: Array) -> tuple[str, str]:
        """Clip a row into a box; return the clipped row and the number of inputs in the box.

        A NaN is in no box. The sum is a matrix product: CasADi imports no reduction
        (docs/sources.md, "ONNX").
        """
        clipped = self.clipped(source, lower, upper)
        same = self.temporary("Equal", [clipped, source], "same")
        same = self.temporary("Cast", [same], "same_number", to=onnx.TensorProto.DOUBLE)
        return clipped, self.temporary("MatMul", [same, np.ones((len(lower), 1))], "inside")

    def bits(self, source: str, thresholds: Array, stem: str, output: str | None = None) -> str:
        """1.0 where a row exceeds its thresholds, else 0.0; 0.0 for NaN."""
        above = self.temporary("Greater", [source, thresholds[None]], stem)
        output = output or self.unique(f"{stem}_bit")
        return self.node("Cast", [above], output, to=onnx.TensorProto.DOUBLE)

    def columns(
        self, source: str, width: int, columns: Sequence[int], stem: str, output: str | None = None
    ) -> str:
        """Select columns of a row by a product: CasADi imports no Gather."""
        selection = np.zeros((width, len(columns)))
        selection[columns, range(len(columns))] = 1.0
        return self.node("MatMul", [source, selection], output or self.unique(stem))


def to_onnx(
    write: Callable[[GraphWriter, str], Any],
    inputs: int,
    metadata: Mapping[str, Any] | None = None,
    input_name: str = ROW,
    outputs: Mapping[str, int] = OUTPUTS,
) -> onnx.ModelProto:
    """ONNX file of a model; the same model gives the same bytes.

    `write` gets the name of the input row and writes each result under its name in `outputs`.
    `metadata` goes to `metadata_props`, each value as JSON: onnxruntime exposes names, units and
    ranges in no other way.
    """
    writer = GraphWriter()
    write(writer, writer.unique(input_name))
    described = [
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.DOUBLE, [1, width])
        for name, width in ((input_name, inputs), *outputs.items())
    ]
    graph = onnx.helper.make_graph(
        writer.nodes, "dropstitch", described[:1], described[1:], writer.constants
    )
    file = onnx.helper.make_model(
        graph, opset_imports=[onnx.helper.make_opsetid("", OPSET)], ir_version=IR_VERSION,
        producer_name="dropstitch",
    )  # fmt: skip
    texts = {k: v if isinstance(v, str) else json.dumps(v) for k, v in (metadata or {}).items()}
    onnx.helper.set_model_props(file, texts)
    onnx.checker.check_model(file)
    return file


_ON_ARRAYS: Final[Mapping[str, Callable[..., Array]]] = {
    "Add": np.add, "Sub": np.subtract, "Mul": np.multiply, "MatMul": np.matmul,
    "Gemm": lambda a, b, c: a @ b + c, "Max": np.maximum, "Min": np.minimum,
    "Equal": np.equal, "Greater": np.greater, "Cast": lambda a, to: a.astype(float),
    "Sqrt": np.sqrt, "Tanh": np.tanh,
}  # fmt: skip
"""Operators that a graph may use, as functions of arrays."""


class _ArrayGraph(GraphWriter):
    """Computes each node on arrays as it is written."""

    def __init__(self) -> None:
        super().__init__()
        self.values: dict[str, Array] = {}

    def constant(self, stem: str, value: Array) -> str:
        name = self.unique(stem)
        self.values[name] = value
        return name

    def node(self, op: str, inputs: Sequence[str | Array], output: str, **attributes: Any) -> str:
        arrays = (self.values[x] if isinstance(x, str) else x for x in inputs)
        self.values[output] = _ON_ARRAYS[op](*arrays, **attributes)
        return output


def evaluate(write: Callable[[GraphWriter, str], str], inputs: Array) -> Array:
    """Compute what `write(graph, source)` writes for many rows at once, (n, width).

    `write` gets the name of the input row and returns that of its result. `inputs`: (n, inputs).
    """
    graph = _ArrayGraph()
    graph.values[graph.unique(ROW)] = inputs
    return graph.values[write(graph, ROW)]


def predictor_inputs(path: Path | str, dof: int) -> tuple[str, ...]:
    """Names of a graph's input columns, from its metadata.

    A graph without names takes angles, currents and DI of `dof` joints.
    """
    try:
        metadata = {prop.key: prop.value for prop in onnx.load(path).metadata_props}
    except Exception:  # protobuf raises other types
        raise InputError(path, "is not an ONNX graph", "train the bundle again") from None
    return named_inputs(metadata, path) or feature_names(dof)


def predictor_function(path: Path | str) -> ca.Function:
    """Import a graph as a symbolic function for differentiation and code generation.

    Agrees with onnxruntime to 1e-12 except for tip_m of an input that is NaN: there CasADi's
    fmin and fmax return the bound and onnxruntime NaN. in_range is 0 in both.
    """
    path = Path(path)
    try:
        graph = onnx.load(path).graph
        imported = ca.GraphBuilder(str(path)).create("imported", {"symbolic": True})
    except Exception as error:  # protobuf and CasADi raise other types
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else "damaged"
        raise InputError(path, f"is not an ONNX graph that CasADi can import ({reason})",
                         "train the bundle again") from None  # fmt: skip
    source = graph.input[0].name
    outputs = [output.name for output in graph.output]
    x = ca.MX.sym(source, imported.size2_in(0))
    values = imported.call([x.T])
    return ca.Function("predictor", [x], [value.T for value in values], [source], outputs)
