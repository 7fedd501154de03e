"""C code of the functions of a `StepModel`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import casadi as ca

from models.plant.step_model import StepModel

FUNCTIONS: Final = ("initial", "begin", "flow", "finish", "output")


def write_model_c(
    model: StepModel, directory: Path, further: Mapping[str, ca.Function] | None = None
) -> Path:
    """Write `model.c` and `model.h` with model_initial, model_begin, …; return the C file.

    Arguments and results are dense vectors, even if CasADi finds them sparse.
    """
    generator = ca.CodeGenerator("model.c", {"with_header": True, "mex": False})
    functions = {name: getattr(model, name) for name in FUNCTIONS} | dict(further or {})
    for name, function in functions.items():
        generator.add(_dense(function, f"model_{name}"))
    generator.generate(f"{directory}/")
    return directory / "model.c"


def _dense(function: ca.Function, name: str) -> ca.Function:
    kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    arguments = [kind.sym(f"i{k}", *function.size_in(k)) for k in range(function.n_in())]
    return ca.Function(name, arguments, [ca.densify(function(*arguments))])
