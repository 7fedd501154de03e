"""Converters from scikit-learn to ONNX in the power form, registered with skl2onnx.

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
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import onnx
from skl2onnx import convert_sklearn, update_registered_converter
from skl2onnx.common.data_types import DoubleTensorType
from sklearn.pipeline import Pipeline

from models.learning.graph_writer import OPSET, GraphWriter
from models.learning.predictors import Array, GuardedPredictor, Polynomial

__all__ = ["PolynomialGraph", "register_model", "to_onnx"]

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
