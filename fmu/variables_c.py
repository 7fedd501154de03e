"""Variable table as C source; `models.plant.simulation.model_c` writes the equations."""

from __future__ import annotations

import math
from pathlib import Path

from fmu.interface import FmiVariable, Interface
from models.plant.step_model import StepModel


def write_variables(model: StepModel, interface: Interface, token: str, directory: Path) -> Path:
    """Write `variables.c` and `variables.h`.

    Parameters
    ----------
    model : StepModel
        Gives the number of states and the longest sub-step.
    interface : Interface
        Variable table of the same model.
    token : str
        Instantiation token that the FMU accepts.
    directory : Path
        Directory of the files.

    Returns
    -------
    Path
        `variables.c`.
    """
    (directory / "variables.h").write_text(_header(model, interface, token), encoding="utf-8")
    (directory / "variables.c").write_text(_table(interface), encoding="utf-8")
    return directory / "variables.c"


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
        f'#define FMU_TOKEN "{token}"',
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
            '#include "fmu_core.h"',
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
