"""Sensitivity of a step model: exact derivatives of its run with respect to parameters."""

from __future__ import annotations

import ctypes
import hashlib
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from models.plant.simulation.compiled_model import trial_inputs, trial_parameters
from models.plant.simulation.lanes_c import LANES_H
from models.plant.simulation.sensitivity_c import write_sensitivity_c
from models.plant.step_model import Array, StepModel, names
from models.shared.c_compiler import compiler_options, load_library
from models.trials.trial import Trial

__all__ = ["SensitiveModel", "run_sensitive_trial"]

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
