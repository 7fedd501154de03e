"""From a `StepModel` to C: the equations by CasADi, the table of variables beside them.

::

    model.c  model.h           initial, begin, flow, finish, output (CasADi)
    variables.c  variables.h   the variable table of `fmu.interface`
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import casadi as ca

from fmu.interface import FmiVariable, Interface
from models.plant.step import StepModel

FUNCTIONS = ("initial", "begin", "flow", "finish", "output")


def write_model(model: StepModel, directory: Path) -> Path:
    """Write `model.c` and `model.h`; returns the former.

    The functions take dense vectors, whatever the sparsity that CasADi found.
    """
    generator = ca.CodeGenerator(
        "model.c", {"with_header": True, "main": False, "mex": False, "verbose": False}
    )
    for name in FUNCTIONS:
        generator.add(_dense(getattr(model, name), f"model_{name}"))
    generator.generate(f"{directory}/")
    return directory / "model.c"


def write_variables(model: StepModel, interface: Interface, token: str, directory: Path) -> Path:
    """Write `variables.c` and `variables.h`; returns the former.

    Parameters
    ----------
    model : StepModel
        For the number of states and the longest sub-step.
    interface : Interface
        Of the same model.
    token : str
        Instantiation token that the unit accepts.
    directory : Path
        Where the files go.
    """
    (directory / "variables.h").write_text(_header(model, interface, token), encoding="utf-8")
    (directory / "variables.c").write_text(_table(interface), encoding="utf-8")
    return directory / "variables.c"


def _dense(function: ca.Function, name: str) -> ca.Function:
    kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    arguments = [kind.sym(f"i{k}", *function.size_in(k)) for k in range(function.n_in())]
    return ca.Function(name, arguments, [ca.densify(function(*arguments))])


def _header(model: StepModel, interface: Interface, token: str) -> str:
    inputs, parameters = interface.of("input"), interface.of("parameter")
    sizes = {
        "N_VARIABLES": len(interface.variables),
        "N_STATES": len(model.states),
        "FIRST_INPUT": 1,
        "FIRST_PARAMETER": 1 + len(inputs),
        "FIRST_OUTPUT": 1 + len(inputs) + len(parameters),
    }
    lines = [
        f"/* Generated for {interface.name}: sizes and value references. */",
        "#ifndef VARIABLES_H",
        "#define VARIABLES_H",
        "",
        f'#define UNIT_TOKEN "{token}"',
        f"#define MAX_SUBSTEP_S {_number(model.max_substep_s)}",
        *(f"#define {name} {value}" for name, value in sizes.items()),
        "",
        *(f"#define {_reference(v)} {v.reference}" for v in interface.variables),
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _table(interface: Interface) -> str:
    rows = [
        f'    [{_reference(v)}] = {{"{v.name}", {v.type.upper()}, {v.causality.upper()}, '
        f"{_number(v.start)}, {_number(v.minimum)}, {_number(v.maximum)}}},"
        for v in interface.variables
    ]
    return "\n".join(
        [
            f"/* Generated for {interface.name}: name, type, causality, start, min, max. */",
            "#include <math.h>",
            "",
            '#include "unit.h"',
            "",
            "const Variable VARIABLES[N_VARIABLES] = {",
            *rows,
            "};",
            "",
        ]
    )


def _reference(variable: FmiVariable) -> str:
    return "VR_" + variable.name.replace(".", "_")


def _number(value: float) -> str:
    """A C constant with the same bits."""
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))
