"""C code of a `StepModel`: for an FMU, and for runs with exact derivatives (`run.c`).

For a run, each function of the model becomes a C function with three results: the value, and the
entries of its sparse derivatives by the states and by the chosen parameters, row by row. Constant
tables in `tables.h` hold the place of each entry. Terms that depend only on the parameters and the
length of a step are computed once per run, by a separate function. The start is also computed once
per run, and its function is long: CasADi's interpreter evaluates it in less time than a compiler
needs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from models.plant.step_model import StepModel

FUNCTIONS: Final = ("initial", "begin", "flow", "finish", "output")

RUN_FILES: Final = {"begin": "step", "rate": "step", "finish": "step", "output": "output"}
"""File of each function of a run; both files take about the same time to compile."""

BLOCK: Final = 16
"""Columns that `run.c` adds at once: four registers of AVX, eight of SSE2."""

_GUARDED_ARGUMENT: Final = re.compile(r"arg\[\d+\]\? (arg\[\d+\]\[\d+\]) : 0(?=;)")
_GUARDED_RESULT: Final = re.compile(r"if \(res\[\d+\]!=0\) (?=res\[)")
_LEFT_OUT: Final = re.compile(r"(arg|res)\d+\[\d+\]=0;")
"""Code that CasADi 3.8 generates: accesses with a test for NULL, and an omitted pointer."""


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


def without_null_tests(code: str) -> str:
    """C code of CasADi without tests of each argument and result for NULL.

    They cost a third of the compile time: 3.0 s instead of 2.0 s for the twin of one joint with
    every effect. The code is unchanged if a call between generated functions omits an argument or a
    result.
    """
    if _LEFT_OUT.search(code):
        return code
    return _GUARDED_RESULT.sub("", _GUARDED_ARGUMENT.sub(r"\1", code))


def write_run_c(
    model: StepModel, index: Sequence[int], directory: Path
) -> tuple[list[Path], ca.Function]:
    """Write `tables.h` and the C code of the derivatives; return the files and the start function.

    `index` are those of the chosen parameters. The start function maps inputs and parameters to the
    state at rest and its slope, in the N_ROWS rows and N_COLUMNS columns of `tables.h`.
    """
    initial = _Derivatives(model.initial, index)
    derived = {what: _Derivatives(getattr(model, what), index) for what in RUN_FILES}
    if model.smooth_finish is not None:
        derived["finish"] = _Derivatives(model.finish, index, model.smooth_finish)
    states, columns = _reached(initial, derived)
    most, results, tables = np.ones(3, dtype=int), {}, [_table("CHOSEN", columns)]
    for what, part in derived.items():
        rows = part.rows(what, states)
        by_x = part.by_x[rows, states].T
        by_p = part.by_p[rows, columns if what != "output" else range(len(index))].T
        results[what] = ca.cse([part.value, ca.vec(by_x.nz[:]), ca.vec(by_p.nz[:])])
        most = np.maximum(most, [result.numel() for result in results[what]])
        place = rows if what == "output" else [states.index(i) for i in rows]
        tables += _tables(what.upper(), place, by_x.sparsity(), by_p.sparsity())
    code, constants = _code(derived, results, len(model.parameters))
    sizes = {
        "STATES": len(model.states), "INPUTS": len(model.inputs), "OUTPUTS": len(model.outputs),
        "CHOSEN": len(index), "ROWS": max(1, len(states)), "COLUMNS": len(columns),
        "CONSTANTS": constants, "BLOCKS": max(1, -(-len(columns) // BLOCK)), "BLOCK": BLOCK,
    }  # fmt: skip
    lines = [f"#define N_{name} {size}" for name, size in sizes.items()]
    lines += [
        f"#define MOST_{n} {m}" for n, m in zip(("VALUES", "BY_X", "BY_P"), most, strict=True)
    ]
    files = {"tables.h": "\n".join([*lines, *tables]) + "\n"}
    files |= {f"run_{file}.c": text for file, text in code.items()}
    for name, text in files.items():  # the same bytes on every system: their hash is a cache's key
        (directory / name).write_text(text, encoding="utf-8", newline="\n")
    slope = ca.densify(initial.by_p[states, columns])
    start = ca.Function("start", initial.arguments, ca.cse([initial.value, slope]))
    return [directory / name for name in files if name.endswith(".c")], start


def _code(
    derived: Mapping[str, _Derivatives], results: Mapping[str, Sequence[Any]], parameters: int
) -> tuple[dict[str, str], int]:
    """Text of each file, and the number of constants that the functions share.

    A constant is a term that depends only on the parameters and the length of a step.
    """
    shared_p, shared_step_s = ca.SX.sym("p", parameters), ca.SX.sym("step_s")
    symbols: list[Any] = []
    values: list[Any] = []
    parts = {}
    for what in RUN_FILES:
        p, lengths = _constant_in(what, derived)
        ends = np.cumsum([0, *(part.numel() for part in results[what])]).tolist()
        whole = ca.vertcat(*results[what])
        remaining, new, terms = ca.extract_parametric(whole, ca.vertcat(p, *lengths))
        parts[what] = ca.vertsplit(remaining, ends)
        symbols += new
        shared = [shared_p, *[shared_step_s] * len(lengths)]
        values += ca.substitute(terms, [p, *lengths], shared)
    constants = ca.vertcat(*symbols)
    files = {
        file: ca.CodeGenerator(f"run_{file}.c", {"mex": False})
        for file in ("output", "step")  # the largest first
    }
    terms = ca.cse([ca.vertcat(*values)])
    files["step"].add(ca.Function("run_constants", [shared_p, shared_step_s], terms))
    for what, file in RUN_FILES.items():
        x, u, p, *time = derived[what].arguments
        files[file].add(ca.Function(f"run_{what}", [x, u, p, constants, *time], parts[what]))
    code = {file: without_null_tests(generator.dump()) for file, generator in files.items()}
    return code, constants.numel()


def _constant_in(what: str, derived: Mapping[str, _Derivatives]) -> tuple[Any, list[Any]]:
    """Parameters of a function, and its arguments that hold the length of a step.

    `begin` may store that length in a state, from which the rates read it. `output` is also
    evaluated before the first step, when the state does not hold it yet.
    """
    x, _, p, *step_s = derived[what].arguments
    if what == "rate":
        begun, length = derived["begin"].value, derived["begin"].arguments[3]
        constant = [i for i in range(x.numel()) if derived["rate"].value[i].is_zero()]
        step_s = [x[i] for i in constant if ca.is_equal(begun[i], length)]
    return p, step_s


class _Derivatives:
    """Value of a function of a model, and its derivatives by states and chosen parameters.

    `smooth` is another form of the function, to be differentiated.
    """

    def __init__(self, function: Any, index: Sequence[int], smooth: Any = None) -> None:
        sizes = [function.size1_in(k) for k in range(function.n_in())]
        self.arguments = [ca.SX.sym(f"i{k}", size) for k, size in enumerate(sizes)]
        self.value = ca.densify(function(*self.arguments))
        self.smooth = self.value if smooth is None else ca.densify(smooth(*self.arguments))
        *before, p = self.arguments[: min(3, len(sizes))]
        x = before[0] if len(before) == 2 else ca.SX(0, 1)  # the initial state depends on no state
        self.by_x = ca.jacobian(self.smooth, x)
        self.by_p = ca.jacobian(self.smooth, p)[:, list(index)]

    def rows(self, what: str, states: Sequence[int]) -> list[int]:
        """Rows of the derivatives to compute.

        Rates that are always zero are left out, and in `begin` and `finish` the states that they do
        not change.
        """
        if what == "output":
            return list(range(self.value.size1()))
        if what == "rate":
            both = _pattern(ca.horzcat(self.by_x, self.by_p))
            return [i for i in states if both[i].any()]
        x = self.arguments[0]
        return [i for i in states if not ca.is_equal(self.smooth[i], x[i])]


def _reached(
    initial: _Derivatives, derived: Mapping[str, _Derivatives]
) -> tuple[list[int], list[int]]:
    """States whose derivatives can become nonzero, and parameters that affect any state."""
    reached = np.array(_pattern(initial.by_p))
    step = np.eye(len(reached), dtype=bool)
    for what in ("begin", "rate", "finish"):
        step |= _pattern(derived[what].by_x)
        reached |= _pattern(derived[what].by_p)
    while not np.array_equal(further := step @ reached, reached):
        reached = further
    states, columns = (np.flatnonzero(reached.any(axis=axis)).tolist() for axis in (1, 0))
    return states, columns


def _pattern(matrix: Any) -> NDArray[np.bool_]:
    return np.asarray(ca.DM(matrix.sparsity(), 1), dtype=bool).reshape(matrix.shape)


def _tables(label: str, place: Sequence[int], by_x: Any, by_p: Any) -> list[str]:
    """Tables of a Jacobian for `run.c`; the patterns are those of the transposes."""
    tables = {
        "ROW": place, "X_START": by_x.colind(), "X_PLACE": by_x.row(),
        "P_START": by_p.colind(), "P_PLACE": by_p.row(),
    }  # fmt: skip
    return [
        *(_table(f"{label}_{name}", values) for name, values in tables.items()),
        f"static const Jacobian {label} = {{{len(place)}, "
        + ", ".join(f"{label}_{name}" for name in tables) + "};",
    ]  # fmt: skip


def _table(name: str, values: Sequence[int]) -> str:
    return f"static const int {name}[] = {{{', '.join(map(str, [*values, 0]))}}};"
