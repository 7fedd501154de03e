"""C code of the derivatives of a `StepModel`: values, entries of sparse Jacobians and places.

A function of the model becomes a C function with three results: the value, and the entries of its
derivatives with respect to the states and to the chosen parameters, row by row. Constant tables in
`tables.h` hold the place of each entry; `run_sensitive.c` reads them. The functions run several
trials in lockstep (`models.plant.simulation.lanes_c`). Terms that depend only on the parameters and
the length of a step are computed once per run, by a separate function. The start is also evaluated
once per run, and its function is long: CasADi's interpreter evaluates it in less time than a
compiler needs.

Sensitivity of a step model: exact derivatives of its run with respect to parameters.
"""

from __future__ import annotations

import ctypes
import hashlib
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from models.plant.simulation.lanes_c import LANES_H, in_lanes
from models.plant.simulation.runner import trial_inputs, trial_parameters
from models.plant.step_model import Array, StepModel, names
from models.shared.c_compiler import compiler_options, load_library
from models.trials.trial import Trial

BLOCK: Final = 16
"""Columns that `run_sensitive.c` adds at once: four registers of AVX, eight of SSE2."""

FUNCTIONS: Final = ("begin", "rate", "finish", "output")

_FILE: Final = {"begin": "step", "rate": "step", "finish": "step", "output": "output"}
"""File of each function; both files take about the same time to compile."""


def write_sensitivity_c(
    model: StepModel, index: Sequence[int], directory: Path
) -> tuple[list[Path], Any]:
    """Write `tables.h` and the C code of the derivatives; return the files and the start function.

    The start function maps inputs and parameters to the state at rest and its slope, in the N_ROWS
    rows and N_COLUMNS columns of `tables.h`.
    """
    initial = _Derivatives(model.initial, index)
    derived = {what: _Derivatives(getattr(model, what), index) for what in FUNCTIONS}
    if model.smooth_finish is not None:
        derived["finish"] = _Derivatives(model.finish, index, model.smooth_finish)
    states, columns = _reached(initial, derived)
    most, results, tables = np.ones(3, dtype=int), {}, [_table("CHOSEN", columns)]
    for what, own in derived.items():
        rows = own.rows(what, states)
        by_x = own.by_x[rows, states].T
        by_p = own.by_p[rows, columns if what != "output" else range(len(index))].T
        results[what] = ca.cse([own.value, ca.vec(by_x.nz[:]), ca.vec(by_p.nz[:])])
        most = np.maximum(most, [part.numel() for part in results[what]])
        place = rows if what == "output" else [states.index(i) for i in rows]
        tables += _tables(what.upper(), place, by_x.sparsity(), by_p.sparsity())
    code, constants = _code(derived, results, len(model.parameters))
    sizes = {
        "STATES": len(model.states), "INPUTS": len(model.inputs), "OUTPUTS": len(model.outputs),
        "PARAMETERS": len(model.parameters), "CHOSEN": len(index),
        "ROWS": max(1, len(states)), "COLUMNS": len(columns), "CONSTANTS": constants,
        "BLOCKS": max(1, -(-len(columns) // BLOCK)), "BLOCK": BLOCK,
    }  # fmt: skip
    lines = [f"#define N_{name} {size}" for name, size in sizes.items()]
    lines += [
        f"#define MOST_{n} {m}" for n, m in zip(("VALUES", "BY_X", "BY_P"), most, strict=True)
    ]
    _write(directory / "tables.h", "\n".join([*lines, *tables]) + "\n")
    sources = {file: directory / f"sensitivity_{file}.c" for file in code}
    for file, path in sources.items():
        _write(path, code[file])
    slope = ca.densify(initial.by_p[states, columns])
    start = ca.Function("start", initial.arguments, ca.cse([initial.value, slope]))
    return [*sources.values()], start


def _code(
    derived: Mapping[str, _Derivatives], results: Mapping[str, Sequence[Any]], parameters: int
) -> tuple[dict[str, str], int]:
    """Text of each file, and the number of constants that the functions share."""
    constants = _Constants(parameters)
    parts = {w: constants.take_out(results[w], *_constant_in(w, derived)) for w in FUNCTIONS}
    symbols = ca.vertcat(*constants.symbols)
    files = {
        file: ca.CodeGenerator(f"sensitivity_{file}.c", {"mex": False})
        for file in ("output", "step")  # the largest first
    }
    files["step"].add(constants.function("sensitivity_constants"))
    for what, file in _FILE.items():
        x, u, p, *time = derived[what].arguments
        function = ca.Function(f"sensitivity_{what}", [x, u, p, symbols, *time], parts[what])
        files[file].add(function)
    code = {file: in_lanes(generator.dump()) for file, generator in files.items()}
    return code, symbols.numel()


def _write(path: Path, text: str) -> None:
    """Write a source with the same bytes on every system, because the cache's key is its hash."""
    path.write_text(text, encoding="utf-8", newline="\n")


class _Constants:
    """Terms of a model's functions that depend only on the parameters and the length of a step."""

    def __init__(self, parameters: int) -> None:
        self._p, self._step_s = ca.SX.sym("p", parameters), ca.SX.sym("step_s")
        self.symbols: list[Any] = []
        self._values: list[Any] = []

    def take_out(self, results: Sequence[Any], p: Any, lengths: Sequence[Any]) -> list[Any]:
        """Replace the constant terms of a function's results by symbols.

        `lengths` are the arguments of the function that hold the length of a step.
        """
        ends = np.cumsum([0, *(part.numel() for part in results)]).tolist()
        whole, known = ca.vertcat(*results), [p, *lengths]
        left, symbols, values = ca.extract_parametric(whole, ca.vertcat(*known))
        self.symbols += symbols
        self._values += ca.substitute(values, known, [self._p, *[self._step_s] * len(lengths)])
        return [*ca.vertsplit(left, ends)]

    def function(self, name: str) -> Any:
        """Function from the parameters and the length of a step to the replaced terms."""
        results = ca.cse([ca.vertcat(*self._values)])
        return ca.Function(name, [self._p, self._step_s], results)


def _constant_in(what: str, derived: Mapping[str, _Derivatives]) -> tuple[Any, list[Any]]:
    """Parameters of a function, and its arguments that hold the length of a step.

    `begin` may store that length in a state, from which the rates read it. `output` is also
    evaluated before the first step, when the state does not hold it yet.
    """
    x, _, p, *step_s = derived[what].arguments
    if what == "rate":
        kept, own = derived["begin"].value, derived["begin"].arguments[3]
        held = [i for i in range(x.numel()) if derived["rate"].value[i].is_zero()]
        step_s = [x[i] for i in held if ca.is_equal(kept[i], own)]
    return p, step_s


class _Derivatives:
    """Value of a function of a model, and its derivatives by states and chosen parameters."""

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
    found = np.array(_pattern(initial.by_p))
    step = np.eye(len(found), dtype=bool)
    for what in ("begin", "rate", "finish"):
        step |= _pattern(derived[what].by_x)
        found |= _pattern(derived[what].by_p)
    while not np.array_equal(further := step @ found, found):
        found = further
    return np.flatnonzero(found.any(axis=1)).tolist(), np.flatnonzero(found.any(axis=0)).tolist()


def _pattern(matrix: Any) -> NDArray[np.bool_]:
    return np.asarray(ca.DM(matrix.sparsity(), 1), dtype=bool).reshape(matrix.shape)


def _tables(label: str, place: Sequence[int], by_x: Any, by_p: Any) -> list[str]:
    """Tables of a Jacobian for `run_sensitive.c`; the patterns are those of the transposes."""
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


_DRIVER: Final = Path(__file__).with_name("run_sensitive.c")
_CPU_INFO: Final = Path("/proc/cpuinfo")
_POINTER: Final = ctypes.POINTER(ctypes.c_double)


class SensitiveModel:
    """A `StepModel` compiled to run whole trials with the exact derivatives of the run.

    The slope S = dx/dp follows the variational equation Ṡ = f_x S + f_p, integrated by the same
    Runge–Kutta steps. So it is the exact derivative of the discrete run, not an approximation of
    the continuous one. The outputs are those of `CompiledModel`, bit by bit.

    `max_substep_s` is another longest sub-step, for a model that is not stiff. `lanes` trials (1,
    2, 4 or 8) can run in lockstep; four take the time of two, except for functions of the C
    library.
    """

    def __init__(
        self,
        model: StepModel,
        wrt: Sequence[str],
        max_substep_s: float | None = None,
        lanes: int = 1,
    ) -> None:
        if model.rate is None:
            raise ValueError(f"{model.name} has no rate")
        self.model = replace(model, max_substep_s=max_substep_s or model.max_substep_s)
        self.wrt, self.lanes = tuple(wrt), lanes
        known = names(model.parameters)
        self._compiled = _compiled(model, [known.index(n) for n in wrt], lanes)

    def simulate(
        self,
        u: Array,
        step_s: float,
        p: Array | None = None,
        first: Array | None = None,
        wanted: NDArray[np.bool_] | None = None,
    ) -> tuple[Array, Array]:
        """Outputs (n + 1, len(outputs)), and derivatives (n + 1, len(outputs), len(wrt)).

        Row k is at k * step_s. `first` (len(inputs),) are the inputs at the start, by default those
        of the first step. `wanted` (len(wrt),) selects the parameters whose derivatives are
        computed; the others are zero.
        """
        p = np.asarray(self.model.parameter_values() if p is None else p)
        first = np.asarray(u[0] if first is None else first)
        y, slope = self.simulate_several(u[None], step_s, p[None], first[None], wanted)
        return y[0], slope[0]

    def simulate_several(
        self,
        u: Array,
        step_s: float,
        p: Array,
        first: Array,
        wanted: NDArray[np.bool_] | None = None,
    ) -> tuple[Array, Array]:
        """Simulate several trials in lockstep, at most as many as lanes; results are bit-identical.

        Shapes: `u` (m, n, len(inputs)), `p` (m, len(parameters)), `first` (m, len(inputs)),
        `wanted` (len(wrt),).
        Returns outputs (m, n + 1, len(outputs)) and derivatives (m, n + 1, len(outputs), len(wrt)).
        """
        if not 1 <= len(u) <= self.lanes:
            raise ValueError(f"{len(u)} trials in {self.lanes} lanes")
        first, u, p = (np.ascontiguousarray(a, dtype=np.float64) for a in (first, u, p))
        y = np.empty((len(u), u.shape[1] + 1, len(self.model.outputs)))
        slope = np.empty((*y.shape, len(self.wrt)))
        x, x_slope = self._compiled.start(first, p)
        times = (ctypes.c_double(step_s), ctypes.c_double(self.model.max_substep_s))
        sizes = ctypes.c_int(len(u)), ctypes.c_long(u.shape[1])
        pointers = [a.ctypes.data_as(_POINTER) for a in (first, u, p, x, x_slope, y, slope)]
        chosen = (np.ones(len(self.wrt), dtype=bool) if wanted is None else wanted).tobytes()
        if self._compiled.library.run_sensitive(*sizes, *times, chosen, *pointers):
            raise MemoryError(f"{self.model.name}: run_sensitive")
        return y, slope


def run_sensitive_trial(
    sensitive: SensitiveModel, trial: Trial, p: Array | None = None
) -> tuple[Array, Array]:
    """Outputs at every row of a trial (n, len(outputs)), and derivatives (…, len(wrt))."""
    first, u = trial_inputs(sensitive.model, trial)
    p = trial_parameters(sensitive.model, trial) if p is None else p
    return sensitive.simulate(u, trial.step_s, p, first)


_SYMBOLIC_WORK: Final = threading.Lock()
"""CasADi marks the nodes of expressions while it sorts them, shared constants too. Two threads that
use its functions at once may corrupt its memory. The compiler needs no lock."""


@dataclass(frozen=True)
class _Compiled:
    """Compiled derivatives of a model."""

    library: ctypes.CDLL  # `run_sensitive.c` with the code of the model
    initial: Any  # Function of the start, from `write_sensitivity_c`

    def start(self, u: Array, p: Array) -> tuple[Array, Array]:
        """State at rest of each trial, and its slope."""
        with _SYMBOLIC_WORK:
            starts = [self.initial(*own) for own in zip(u, p, strict=True)]
        parts = zip(*([part.full() for part in start] for start in starts), strict=True)
        x, slope = (np.ascontiguousarray(np.stack(part)) for part in parts)
        return x, slope


_COMPILED: Final[dict[bytes, _Compiled]] = {}
"""Compiled derivatives by hash of the model, because differentiating an observer takes seconds."""


def _compiled(model: StepModel, index: Sequence[int], lanes: int) -> _Compiled:
    """Compiled derivatives of a model with respect to the parameters at these indices."""
    flags = (*_vector_flags(), f"-DN_LANES={lanes}")
    digest = hashlib.sha256(repr((list(index), flags, compiler_options())).encode())
    with _SYMBOLIC_WORK:
        for part in vars(model).values():
            if isinstance(part, ca.Function):
                digest.update(part.serialize().encode())
    key = digest.digest()
    if key not in _COMPILED:
        initial: list[Any] = []

        def write(directory: Path) -> list[Path]:
            with _SYMBOLIC_WORK:
                sources, start = write_sensitivity_c(model, index, directory)
            initial.append(start)
            return [*sources, _DRIVER]

        library = load_library(write, include=[LANES_H.parent], flags=flags, at_once=True)
        _COMPILED[key] = _Compiled(library, initial[0])
    return _COMPILED[key]


def _vector_flags() -> tuple[str, ...]:
    """Options of the compiler for this processor's vectors; results stay bit-identical."""
    if not _CPU_INFO.is_file():
        return ()
    known = _CPU_INFO.read_text(encoding="utf-8", errors="replace")
    return ("-mavx2",) if " avx2 " in known else ()
