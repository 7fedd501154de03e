"""Writer of ONNX graphs from NumPy constants, for the converters of skl2onnx."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import onnx

from models.learning.power_form import power_form
from models.learning.predictors import Array, Polynomial

__all__ = ["OPSET", "GraphWriter"]

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
