"""Symbolic import of an ONNX file of `models.learning.onnx_power` as a CasADi function.

The twin and predictor FMUs are generated from it, so the FMU and onnxruntime on the robot evaluate
the same file.
"""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import onnx

from firmware_py.errors import InputError
from firmware_py.inference.predictor import named_inputs
from firmware_py.signals import feature_names

__all__ = ["predictor_function", "predictor_inputs"]


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
