"""Writer of ONNX graphs from NumPy constants, for the converters of skl2onnx.

Converters from scikit-learn to ONNX in the power form, registered with skl2onnx.

A polynomial of degree d in n inputs is an exact sum of d-th powers of linear forms (a Waring
decomposition), so that

    y = (([1, x] A) ** d) C

needs one Gemm, one to three Mul and one MatMul whatever the number of monomials, where skl2onnx
itself writes 2 M + 5 nodes for M monomials (docs/sources.md, "ONNX").
Two models have converters here:

`PolynomialGraph`   one polynomial, its inputs clipped into the training box or not
`GuardedPredictor`  features -> tip_m, in_range, half_width_m, in one graph

All graphs are float64, batch 1, opset 13, IR 7, so that onnxruntime from 1.16 on loads them, and
use only operators that CasADi imports (tested). `in_range` is 1.0 or 0.0; it is 0.0 and the half
width is NaN where an input is NaN.

Symbolic import of an ONNX file of `models.predictor.onnx_graphs` as a CasADi function.

The twin and predictor FMUs are generated from it, so the FMU and onnxruntime on the robot evaluate
the same file.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np
import onnx
from skl2onnx import convert_sklearn, update_registered_converter
from skl2onnx.common.data_types import DoubleTensorType
from sklearn.pipeline import Pipeline

from firmware_py.errors import InputError
from firmware_py.inference.predictor import named_inputs
from firmware_py.signals import feature_names
from models.predictor.polynomials import Array, GuardedPredictor, Polynomial, power_form

OPSET: Final = 13
"""Version of the operators that onnxruntime 1.16 and later load."""


class GraphWriter:
    """Writes nodes and constants into skl2onnx's container, under stable, unique names."""

    def __init__(self, scope: Any, container: Any) -> None:
        self.scope, self.container = scope, container

    def constant(self, name: str, value: Array) -> str:
        """Add a float64 constant; return its unique name."""
        unique: str = self.scope.get_unique_variable_name(name)
        shape = list(value.shape)
        self.container.add_initializer(unique, onnx.TensorProto.DOUBLE, shape, value.ravel())
        return unique

    def node(self, op: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        """Add an operator whose result is called `output`; return that name."""
        name = self.scope.get_unique_operator_name(f"{output}_{op}")
        self.container.add_node(
            op, list(inputs), [output], name=name, op_version=OPSET, **attributes
        )
        return output

    def temporary(self, op: str, inputs: Sequence[str], stem: str, **attributes: Any) -> str:
        """Add an operator; return the unique name of its result."""
        return self.node(op, inputs, self.scope.get_unique_variable_name(stem), **attributes)

    def clipped(self, source: str, lower: Array, upper: Array) -> str:
        """Clip a row into a box."""
        raised = self.temporary("Max", [source, self.constant("lower", lower[None])], "raised")
        return self.temporary("Min", [raised, self.constant("upper", upper[None])], "clipped")

    def bits(self, source: str, thresholds: Array, stem: str) -> str:
        """1.0 where a row exceeds its thresholds, else 0.0; 0.0 for NaN."""
        above = self.temporary(
            "Greater", [source, self.constant(f"{stem}_threshold", thresholds[None])], stem
        )
        return self.temporary("Cast", [above], f"{stem}_bit", to=onnx.TensorProto.DOUBLE)

    def columns(self, source: str, width: int, columns: Sequence[int], stem: str) -> str:
        """Select columns of a row by a product: CasADi imports no Gather."""
        selection = np.zeros((width, len(columns)))
        selection[list(columns), range(len(columns))] = 1.0
        return self.temporary("MatMul", [source, self.constant(f"{stem}_columns", selection)], stem)

    def polynomial(self, source: str, polynomial: Polynomial, stem: str, output: str) -> str:
        """Write a polynomial in the power form."""
        rows, bias, weights = power_form(polynomial)
        forms = self.temporary(
            "Gemm",
            [source, self.constant(f"{stem}_rows", rows), self.constant(f"{stem}_bias", bias)],
            f"{stem}_forms",
        )
        power = self.power(forms, polynomial.degree, stem)
        return self.node("MatMul", [power, self.constant(f"{stem}_weights", weights)], output)

    def power(self, base: str, degree: int, stem: str) -> str:
        """Raise to a power by repeated squaring: Pow is slow, and CasADi broadcasts it wrongly."""
        result = ""
        while degree:
            if degree & 1:
                result = self.temporary("Mul", [result, base], f"{stem}_power") if result else base
            degree >>= 1
            if degree:
                base = self.temporary("Mul", [base, base], f"{stem}_square")
        return result


IR_VERSION: Final = 7
"""Version of the file format that onnxruntime 1.16 and later load."""


@dataclass(frozen=True)
class PolynomialGraph:
    """Fitted `polynomial_pipeline` that is converted alone."""

    pipeline: Pipeline
    output: str  # Name of the graph's output
    # (n,) each, lower and upper bounds that the inputs are clipped to; none by default
    box: tuple[Array, Array] | None = None


def _convert_polynomial(scope: Any, operator: Any, container: Any) -> None:
    model: PolynomialGraph = operator.raw_operator
    graph = GraphWriter(scope, container)
    source = operator.inputs[0].full_name
    if model.box is not None:
        source = graph.clipped(source, *model.box)
    graph.polynomial(
        source, Polynomial.of(model.pipeline), model.output, operator.outputs[0].full_name
    )


def _convert_guarded(scope: Any, operator: Any, container: Any) -> None:
    model: GuardedPredictor = operator.raw_operator
    graph = GraphWriter(scope, container)
    source = operator.inputs[0].full_name
    tip, in_range, half_width = (variable.full_name for variable in operator.outputs)

    clipped = graph.clipped(source, model.lower, model.upper)
    graph.polynomial(clipped, Polynomial.of(model.pipeline), "tip", tip)

    count = len(model.lower)  # matrix product instead of a Reduce operator: docs/sources.md, "ONNX"
    same = graph.temporary("Equal", [clipped, source], "same")
    same = graph.temporary("Cast", [same], "same_number", to=onnx.TensorProto.DOUBLE)
    ones = graph.constant("ones", np.ones((count, 1)))
    inside = graph.temporary("MatMul", [same, ones], "inside")
    every = graph.constant("count", np.full((1, 1), count - 0.5))
    inside = graph.temporary("Greater", [inside, every], "all_inside")
    graph.node("Cast", [inside], in_range, to=onnx.TensorProto.DOUBLE)

    leverage = graph.polynomial(
        source, model.leverage, "leverage", scope.get_unique_variable_name("leverage")
    )
    one = graph.constant("one", np.ones((1, 1)))
    variance = graph.temporary("Add", [leverage, one], "relative_variance")
    root = graph.temporary("Sqrt", [variance], "relative_width")
    graph.node("MatMul", [root, graph.constant("quantile", model.quantile[None])], half_width)


def register_model(
    kind: type,
    convert: Callable[[Any, Any, Any], None],
    outputs: Callable[[Any], Mapping[str, int]],
) -> None:
    """Register a model with skl2onnx, so that `to_onnx` accepts it."""

    def parse(scope: Any, model: Any, inputs: Any, custom_parsers: Any = None) -> Any:
        operator = scope.declare_local_operator(f"Dropstitch{kind.__name__}", model)
        operator.inputs.extend(inputs)
        for name, width in outputs(model).items():
            variable = scope.declare_local_variable(name, DoubleTensorType([1, width]))
            operator.outputs.append(variable)
        return operator.outputs

    update_registered_converter(
        kind, f"Dropstitch{kind.__name__}", _keep_shapes, convert, parser=parse
    )


def _keep_shapes(operator: Any) -> None:
    """Do nothing, because the parser declares the shapes."""


register_model(
    PolynomialGraph,
    _convert_polynomial,
    lambda model: {model.output: Polynomial.of(model.pipeline).coefficients.shape[1]},
)
register_model(
    GuardedPredictor,
    _convert_guarded,
    lambda model: {
        "tip_m": len(model.quantile),
        "in_range": 1,
        "half_width_m": len(model.quantile),
    },
)


def to_onnx(
    model: Any,
    inputs: int,
    input_name: str = "features",
    metadata: Mapping[str, Any] | None = None,
) -> onnx.ModelProto:
    """Convert a model to an ONNX graph; the same model gives the same bytes.

    `metadata` is written to `metadata_props`, each value as JSON. onnxruntime exposes names, units
    and ranges in no other way.
    """
    graph = convert_sklearn(
        model,
        name="dropstitch",
        initial_types=[(input_name, DoubleTensorType([1, inputs]))],
        target_opset=OPSET,
    )
    graph.ir_version = IR_VERSION
    del graph.opset_import[:]
    graph.opset_import.extend([onnx.helper.make_opsetid("", OPSET)])
    texts = {k: v if isinstance(v, str) else json.dumps(v) for k, v in (metadata or {}).items()}
    onnx.helper.set_model_props(graph, texts)
    onnx.checker.check_model(graph)
    return graph


def predictor_inputs(path: Path | str, dof: int) -> tuple[str, ...]:
    """Names of a graph's input columns, from its metadata.

    A graph without names takes angles, currents and DI of `dof` joints.
    """
    try:
        metadata = {prop.key: prop.value for prop in onnx.load(path).metadata_props}
    except Exception:  # protobuf raises types of its own
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
    except Exception as error:  # protobuf and CasADi raise types of their own
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else "damaged"
        raise InputError(path, f"is not an ONNX graph that CasADi can import ({reason})",
                         "train the bundle again") from None  # fmt: skip
    source = graph.input[0].name
    outputs = [output.name for output in graph.output]
    x = ca.MX.sym(source, imported.size2_in(0))
    values = imported.call([x.T])
    return ca.Function("predictor", [x], [value.T for value in values], [source], outputs)
