"""Generated C source of an FMU: equations, sizes, variable table."""

from __future__ import annotations

import math
from itertools import accumulate
from pathlib import Path

from firmware_py.core.motion import STUDY_PERIOD_S
from fmu.interface import Interface
from fmu.relations import SAMPLE_S, Relations
from models.plant.simulation.model_c import FUNCTIONS, without_null_tests, write_model_c
from models.plant.step_model import StepModel


def write_equations(model: StepModel, interface: Interface, directory: Path) -> Path:
    """Write `model.c` and `model.h`: the equations of the model and of its relations.

    They use the functions of `fmu_math.h` instead of the C library's sine and so on, for the same
    bits on every platform. The core passes all arguments and results, so no test for NULL is left.
    """
    model_c = write_model_c(model, directory, interface.relations.functions)
    text = model_c.read_text(encoding="utf-8")
    text = f'#include "fmu_math.h"\n{without_null_tests(text)}'
    model_c.write_text(text, encoding="utf-8", newline="\n")
    return model_c


def write_variables(model: StepModel, interface: Interface, token: str, directory: Path) -> Path:
    """Write `variables.c` and `variables.h`."""
    (directory / "variables.h").write_text(
        _header(model, interface, token), encoding="utf-8", newline="\n"
    )
    (directory / "variables.c").write_text(_table(interface), encoding="utf-8", newline="\n")
    return directory / "variables.c"


def _header(model: StepModel, interface: Interface, token: str) -> str:
    relations = interface.relations
    first = list(
        accumulate(
            [1, *(len(interface.of(group)) for group in ("input", "parameter", "output")),
             len(model.states), len(relations.continuous)]
        )
    )  # fmt: skip
    groups = ("INPUT", "PARAMETER", "OUTPUT", "STATE", "DERIVATIVE", "INDICATOR")
    sizes: dict[str, int | str] = {
        "N_VARIABLES": len(interface.variables),
        "N_STATES": len(model.states),
        **{f"FIRST_{group}": place for group, place in zip(groups, first, strict=True)},
        "SAMPLED": int(relations.sampled),
        "WITH_EXAMPLE": int(bool(interface.example)),
        "WITH_FORWARD": int(relations.derivatives != "none"),
        "WITH_REVERSE": int(relations.derivatives == "both"),
        **_work(relations),
    }
    lines = [
        f"/* Generated for {interface.name}: sizes. */",
        "#ifndef VARIABLES_H",
        "#define VARIABLES_H",
        "",
        f'#define FMU_TOKEN "{token}"',
        f"#define MAX_SUBSTEP_S {_number(model.max_substep_s)}",
        f"#define SAMPLE_S {_number(SAMPLE_S)}",
        f"#define EXAMPLE_PERIOD_S {_number(STUDY_PERIOD_S)}",
        *(f"#define {name} {value}" for name, value in sizes.items()),
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _work(relations: Relations) -> dict[str, str]:
    """Sizes of the work memory as constant expressions of C: the largest need of any function.

    The size of a union is that of its largest member.
    """
    functions = [*FUNCTIONS, *relations.functions]
    kinds = {"ARGUMENTS": "ARG", "RESULTS": "RES", "INTEGERS": "IW", "REALS": "W"}
    sizes = {}
    for name, kind in kinds.items():
        members = " \\\n    ".join(f"char {f}[1 + model_{f}_SZ_{kind}];" for f in functions)
        sizes[f"WORK_{name}"] = f"(sizeof(union {{ \\\n    {members} \\\n}}))"
    return sizes


def _table(interface: Interface) -> str:
    rows = [
        f'    {{"{v.name}", {v.type.upper()}, {v.causality.upper()}, {int(v.sampled)}, '
        f"{_number(v.start)}, {_number(v.minimum)}, {_number(v.maximum)}}},"
        for v in interface.variables
    ]
    places = interface.relations.continuous or (0,)
    example = interface.example or (0.0,) * max(1, len(interface.of("input")))
    nominals = [v.nominal for v in interface.continuous_states] or [1.0]
    return "\n".join(
        [
            f"/* Generated for {interface.name}. */",
            "#include <math.h>",
            "",
            '#include "fmu_core.h"',
            "",
            "/* Name, type, causality, whether it is sampled, start, min, max. */",
            "const Variable VARIABLES[N_VARIABLES] = {",
            *rows,
            "};",
            "",
            f"const int CONTINUOUS_STATES[{len(places)}] = {{{', '.join(map(str, places))}}};",
            f"const double NOMINALS[{len(nominals)}] = {{{', '.join(map(_number, nominals))}}};",
            f"const double EXAMPLE[{len(example)}] = {{{', '.join(map(_number, example))}}};",
            "",
        ]
    )


def _number(value: float) -> str:
    """C constant with the same bits."""
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))
