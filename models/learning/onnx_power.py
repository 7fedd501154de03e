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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import onnx
from skl2onnx import convert_sklearn, update_registered_converter
from skl2onnx.common.data_types import DoubleTensorType
from sklearn.pipeline import Pipeline

from models.learning.power_form import power_form
from models.learning.predictors import Array, GuardedPredictor, Polynomial

__all__ = ["PolynomialGraph", "to_onnx"]

OPSET: Final = 13
IR_VERSION: Final = 7
"""Versions of operators and file format that onnxruntime 1.16 and later load."""


@dataclass(frozen=True)
class PolynomialGraph:
    """Fitted `polynomial_pipeline` that is converted by itself.

    Attributes
    ----------
    pipeline : sklearn Pipeline
        Fitted.
    output : str
        Name of the graph's output.
    box : tuple of two ndarray, shape (n,), optional
        Lower and upper bounds that the inputs are clipped to; by default they are not clipped.
    """

    pipeline: Pipeline
    output: str
    box: tuple[Array, Array] | None = None


class _Graph:
    """Builder that adds nodes and constants to skl2onnx's container under stable, unique names."""

    def __init__(self, scope: Any, container: Any) -> None:
        self.scope, self.container = scope, container

    def constant(self, name: str, value: Array) -> str:
        unique: str = self.scope.get_unique_variable_name(name)
        shape = list(value.shape)
        self.container.add_initializer(unique, onnx.TensorProto.DOUBLE, shape, value.ravel())
        return unique

    def node(self, op: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        name = self.scope.get_unique_operator_name(f"{output}_{op}")
        self.container.add_node(
            op, list(inputs), [output], name=name, op_version=OPSET, **attributes
        )
        return output

    def temporary(self, op: str, inputs: Sequence[str], stem: str, **attributes: Any) -> str:
        return self.node(op, inputs, self.scope.get_unique_variable_name(stem), **attributes)

    def clipped(self, source: str, lower: Array, upper: Array) -> str:
        raised = self.temporary("Max", [source, self.constant("lower", lower[None])], "raised")
        return self.temporary("Min", [raised, self.constant("upper", upper[None])], "clipped")

    def polynomial(self, source: str, polynomial: Polynomial, stem: str, output: str) -> str:
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


def _convert_polynomial(scope: Any, operator: Any, container: Any) -> None:
    model: PolynomialGraph = operator.raw_operator
    graph = _Graph(scope, container)
    source = operator.inputs[0].full_name
    if model.box is not None:
        source = graph.clipped(source, *model.box)
    graph.polynomial(
        source, Polynomial.of(model.pipeline), model.output, operator.outputs[0].full_name
    )


def _convert_guarded(scope: Any, operator: Any, container: Any) -> None:
    model: GuardedPredictor = operator.raw_operator
    graph = _Graph(scope, container)
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


def _outputs_of(model: Any) -> dict[str, int]:
    if isinstance(model, PolynomialGraph):
        return {model.output: Polynomial.of(model.pipeline).coefficients.shape[1]}
    axes = len(model.quantile)
    return {"tip_m": axes, "in_range": 1, "half_width_m": axes}


def _parse(scope: Any, model: Any, inputs: Any, custom_parsers: Any = None) -> Any:
    operator = scope.declare_local_operator(f"Dropstitch{type(model).__name__}", model)
    operator.inputs.extend(inputs)
    for name, width in _outputs_of(model).items():
        operator.outputs.append(scope.declare_local_variable(name, DoubleTensorType([1, width])))
    return operator.outputs


def _keep_shapes(operator: Any) -> None:
    """Do nothing: `_parse` declares the shapes."""


for _model, _convert in (
    (PolynomialGraph, _convert_polynomial),
    (GuardedPredictor, _convert_guarded),
):
    update_registered_converter(
        _model, f"Dropstitch{_model.__name__}", _keep_shapes, _convert, parser=_parse
    )


def to_onnx(
    model: PolynomialGraph | GuardedPredictor,
    inputs: int,
    input_name: str = "features",
    metadata: Mapping[str, Any] | None = None,
) -> onnx.ModelProto:
    """Convert a model to an ONNX graph.

    Parameters
    ----------
    model : PolynomialGraph or GuardedPredictor
        Fitted.
    inputs : int
        Number of features.
    input_name : str
        Name of the graph's input, float64 [1, inputs].
    metadata : mapping, optional
        Written to `metadata_props`, each value as JSON. onnxruntime exposes names, units and
        ranges in no other way.

    Returns
    -------
    onnx.ModelProto
        The same bytes for the same model.

    Examples
    --------
    The graph of y = 1 + 2 x evaluates to 7 at x = 3:

    >>> import numpy as np
    >>> import onnxruntime
    >>> from models.learning.predictors import polynomial_pipeline
    >>> x = np.array([[0.0], [1.0], [2.0]])
    >>> pipeline = polynomial_pipeline(1).fit(x, 1.0 + 2.0 * x)
    >>> graph = to_onnx(PolynomialGraph(pipeline, "y"), inputs=1, input_name="x")
    >>> session = onnxruntime.InferenceSession(graph.SerializeToString())
    >>> y = session.run(["y"], {"x": np.array([[3.0]])})[0]
    >>> round(float(y[0, 0]), 9)
    7.0
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
