"""Run of a plant: compiled model, inputs and parameters from a trial, simulation from arrays."""

from __future__ import annotations

import ctypes
import hashlib
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from models.plant.plant import Plant
from models.plant.simulation.model_c import write_run_c
from models.plant.step_model import Array as Array
from models.plant.step_model import StepModel, names
from models.shared.c_compiler import compiler_options, load_library
from models.trials.trial import Trial

_POINTER: Final = ctypes.POINTER(ctypes.c_double)

_SYMBOLIC_WORK: Final = threading.Lock()
"""CasADi marks the nodes of expressions while it sorts them, shared constants too. Two threads that
use its functions at once may corrupt its memory. The compiler needs no lock."""

_COMPILED: Final[dict[bytes, tuple[ctypes.CDLL, ca.Function]]] = {}
"""Compiled run and function of its start (`write_run_c`), by hash of model and parameters, because
differentiating an observer takes seconds."""


class CompiledModel:
    """A `StepModel` compiled to run whole trials, with exact derivatives by the parameters `wrt`.

    The run is that of `StepModel.simulate`. The slope S = dx/dp follows the variational equation
    Ṡ = f_x S + f_p, integrated by the same Runge–Kutta steps. So it is the exact derivative of the
    discrete run, not an approximation of the continuous one. Libraries are cached by content, so a
    model is compiled once.
    """

    def __init__(self, model: StepModel, wrt: Sequence[str] = ()) -> None:
        self.model, self.wrt = model, tuple(wrt)
        known = names(model.parameters)
        self._library, self._start = _compiled(model, [known.index(n) for n in wrt])

    def start(self, u: Array, p: Array) -> Array:
        """State at rest under inputs u (len(inputs),) and parameters p (len(parameters),)."""
        return self._started(u, p)[0]

    def simulate(
        self, u: Array, step_s: float, p: Array | None = None, x: Array | None = None
    ) -> Array:
        """Outputs at the start and after each step, shape (n + 1, len(outputs)).

        Row k is at k * step_s, the first from the state `x`, by default at rest.
        """
        p = np.asarray(self.model.parameter_values() if p is None else p)
        x, none = self.start(u[0], p) if x is None else x, np.zeros(len(self.wrt), dtype=bool)
        return self._run(u, step_s, p, x, np.empty(0), none)[0]

    def derivatives(
        self,
        u: Array,
        step_s: float,
        p: Array | None = None,
        first: Array | None = None,
        wanted: NDArray[np.bool_] | None = None,
    ) -> tuple[Array, Array]:
        """Outputs as from `simulate`, and their derivatives (n + 1, len(outputs), len(wrt)).

        `first` (len(inputs),) are the inputs under which the run starts at rest, by default those
        of the first step. `wanted` (len(wrt),) selects the parameters whose derivatives are
        computed; the others are zero.
        """
        p = np.asarray(self.model.parameter_values() if p is None else p)
        x, slope = self._started(u[0] if first is None else first, p)
        wanted = np.ones(len(self.wrt), dtype=bool) if wanted is None else wanted
        return self._run(u, step_s, p, x, slope, wanted)

    def _started(self, u: Array, p: Array) -> tuple[Array, Array]:
        with _SYMBOLIC_WORK:
            x, slope = (part.full() for part in self._start(u, p))
        return x.ravel(), np.ascontiguousarray(slope)

    def _run(
        self, u: Array, step_s: float, p: Array, x: Array, x_slope: Array, wanted: NDArray[np.bool_]
    ) -> tuple[Array, Array]:
        y = np.empty((len(u) + 1, len(self.model.outputs)))
        slope = np.empty((*y.shape, len(self.wrt)))
        times = (ctypes.c_double(step_s), ctypes.c_double(self.model.max_substep_s))
        arrays = [np.ascontiguousarray(a, dtype=np.float64) for a in (u, p, x, x_slope)]
        pointers = [a.ctypes.data_as(_POINTER) for a in (*arrays, y, slope)]
        if self._library.run(ctypes.c_long(len(u)), *times, wanted.tobytes(), *pointers):
            raise MemoryError(f"{self.model.name}: run")
        return y, slope


def _compiled(model: StepModel, index: Sequence[int]) -> tuple[ctypes.CDLL, ca.Function]:
    """Compiled run of a model with derivatives by the parameters at these indices."""
    flags = _vector_flags()
    digest = hashlib.sha256(repr((list(index), flags, compiler_options())).encode())
    with _SYMBOLIC_WORK:
        for part in vars(model).values():
            if isinstance(part, ca.Function):
                digest.update(part.serialize().encode())
    key = digest.digest()
    if key not in _COMPILED:
        start: list[ca.Function] = []

        def write(directory: Path) -> list[Path]:
            with _SYMBOLIC_WORK:
                sources, initial = write_run_c(model, index, directory)
            start.append(initial)
            return [*sources, Path(__file__).with_name("run.c")]

        library = load_library(write, flags=flags)
        _COMPILED[key] = library, start[0]
    return _COMPILED[key]


def _vector_flags() -> tuple[str, ...]:
    """Options of the compiler for this processor's vectors; results stay bit-identical.

    Without errno, the sine and the cosine of one number are one call.
    """
    info = Path("/proc/cpuinfo")
    known = info.read_text(encoding="utf-8", errors="replace") if info.is_file() else ""
    return ("-fno-math-errno", *(("-mavx2",) if " avx2 " in known else ()))


def trial_parameters(model: StepModel, trial: Trial) -> Array:
    """Parameter vector: the plant's values, with the trial's geometry, conditions and start."""
    meta, columns = trial.meta, trial.columns
    dimensions = ("base_offset_m", "link_length_m", "link_width_m")
    values = {n: getattr(meta, n) for n in dimensions if meta.link_length_m} | meta.conditions
    for j in range(1, meta.dof + 1):
        for position, unit in ((f"angle_{j}_rad", "rad"), (f"position_{j}_m", "m")):
            if position in columns:
                goal = columns.get(f"goal_{j}_{unit}", np.zeros(1))
                values[f"start_offset_{j}_{unit}"] = columns[position][0] - goal[0]
                values[f"start_joint_rate_{j}_{unit}_s"] = start_of_motion(trial, position)[1]
        deflection = f"deflection_{j}_rad"
        if deflection in columns:
            start, rate = start_of_motion(trial, deflection)
            values[f"start_{deflection}"] = start
            values[f"start_deflection_rate_{j}_rad_s"] = rate
    known = set(names(model.parameters))
    return model.parameter_values({n: v for n, v in values.items() if n in known})


def model_inputs(model: StepModel, trial: Trial) -> Array:
    """Inputs of a model from a trial's columns, shape (n, len(inputs)).

    The payload is the declared one. A drive is enabled unless a column says otherwise.
    """
    constant = {f"enabled_{j}": 1.0 for j in range(1, trial.meta.dof + 1)}
    constant["payload_kg"] = trial.meta.payload_kg
    columns = {n: np.full(len(trial), v) for n, v in constant.items()} | dict(trial.columns)
    for name in names(model.inputs):
        if name not in columns:
            raise InputError(
                trial.path, f"column {name} is missing, which the plant takes as an input",
                "use a trial of the plant's kind",
            )  # fmt: skip
    return np.column_stack([columns[name] for name in names(model.inputs)])


def trial_inputs(model: StepModel, trial: Trial) -> tuple[Array, Array]:
    """Inputs at the start (len(inputs),) and of each step between two rows (n - 1, len(inputs)).

    A twin is driven by the goal that was sent after a row, until the next one. A model driven by
    measurements uses the sample at the end of each step.
    """
    u = model_inputs(model, trial)
    return u[0], u[1:] if model.inputs_at_end else u[:-1]


def run_trial(compiled: CompiledModel, trial: Trial, p: Array | None = None) -> Array:
    """Outputs of a model at every row of a trial, shape (n, len(outputs)); see `trial_inputs`."""
    first, u = trial_inputs(compiled.model, trial)
    p = trial_parameters(compiled.model, trial) if p is None else p
    return compiled.simulate(u, trial.step_s, p, compiled.start(first, p))


def differentiate_trial(
    compiled: CompiledModel, trial: Trial, p: Array, wanted: NDArray[np.bool_] | None = None
) -> tuple[Array, Array]:
    """Outputs as from `run_trial`, and their derivatives; see `CompiledModel.derivatives`."""
    first, u = trial_inputs(compiled.model, trial)
    return compiled.derivatives(u, trial.step_s, p, first, wanted)


def start_of_motion(trial: Trial, column: str) -> tuple[float, float]:
    """Value and rate of a column at the first row, by a parabola through its first rows.

    A long window averages noise, a short one follows a jerk. The longest window up to 50 ms (a
    quarter of a period at 5 Hz) is used whose rate agrees with that of every shorter one, down to 5
    rows: intersection of confidence intervals of 2 standard deviations [Goldenshluger & Nemirovski
    1997; Katkovnik 1999]. The noise is estimated from the third differences, which a smooth motion
    hardly has.
    """
    least = 5
    longest = min(max(least, round(0.05 / trial.step_s)), len(trial))
    time_s, values = trial.time_s[:longest] - trial.time_s[0], trial.columns[column][:longest]
    measured = np.isfinite(values)
    time_s, values = time_s[measured], values[measured]
    if len(values) < least:
        return 0.0, 0.0
    noise = float(np.sqrt(np.mean(np.diff(values, 3) ** 2) / 20))  # 1 + 9 + 9 + 1
    low, high, chosen = -np.inf, np.inf, (0.0, 0.0)
    for rows in range(least, len(values) + 1):
        powers = np.vander(time_s[:rows] / time_s[rows - 1], 3, increasing=True)
        inverse = np.linalg.pinv(powers)
        value, slope, _ = inverse @ values[:rows]
        rate = slope / time_s[rows - 1]
        error = 2.0 * noise * float(np.linalg.norm(inverse[1])) / time_s[rows - 1]
        low, high = max(low, rate - error), min(high, rate + error)
        if low > high:
            break
        chosen = float(value), float(rate)
    return chosen


def simulate_plant(
    plant: Plant, inputs: Mapping[str, ArrayLike], step_s: float = PERIOD_S, dof: int = 1
) -> dict[str, Array]:
    """Simulate the twin of a plant from rest.

    Parameters
    ----------
    plant : Plant
        Plant to simulate.
    inputs : mapping of str to array_like, shape (n,) or ()
        Inputs of the twin by name, in SI units; a single number is constant. Row k acts from
        `k * step_s` on. By default `payload_kg` is 0 and `enabled_j` is 1.
    step_s : float
        Time between two rows in s.
    dof : int
        Number of joints, 1 or 2.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Time, inputs and outputs by name; row k at `k * step_s`.

    Raises
    ------
    InputError
        If an input is missing, unknown or of another length, or the simulation does not stay
        finite.

    Examples
    --------
    >>> from firmware_py.core.motion import Motion
    >>> from models.plant.plant import read_plant
    >>> goal_rad = Motion(period_s=2.0).table_rad()[:, 0]
    >>> run = simulate_plant(read_plant(), {"goal_1_rad": goal_rad, "payload_kg": 1.0})
    >>> list(run)[:4], len(run["tip_x_m"]) == len(goal_rad)
    (['time_s', 'goal_1_rad', 'payload_kg', 'angle_1_rad'], True)
    """
    model = plant.step_model(dof, "twin")
    rows = _rows(names(model.inputs), inputs, dof)
    u = np.column_stack([*rows.values()])
    y = CompiledModel(model).simulate(u[:-1], step_s)
    if not np.isfinite(y).all():
        raise InputError(
            f"plant {plant.name!r}", "does not stay finite", "give inputs that it can follow"
        )
    time_s: Array = step_s * np.arange(len(u), dtype=np.float64)
    outputs = {name: np.ascontiguousarray(y[:, k]) for k, name in enumerate(names(model.outputs))}
    return {"time_s": time_s, **rows, **outputs}


def _rows(wanted: Sequence[str], inputs: Mapping[str, ArrayLike], dof: int) -> dict[str, Array]:
    """Inputs in the order of the model, all of one length."""
    usual = {"payload_kg": 0.0} | {f"enabled_{j}": 1.0 for j in range(1, dof + 1)}
    inputs = {name: value for name, value in usual.items() if name in wanted} | dict(inputs)
    for name in sorted({*wanted} ^ inputs.keys()):
        what = "is missing" if name in wanted else "is no input of this plant"
        raise InputError(name, what, "give " + ", ".join(wanted))
    arrays = {name: np.asarray(inputs[name], dtype=np.float64) for name in wanted}
    count = max((len(a) for a in arrays.values() if a.ndim == 1), default=0)
    for name, array in arrays.items():
        if array.shape not in ((), (count,)) or count < 2:
            raise InputError(
                name, f"has the shape {array.shape}", "give two rows or more, all of one length"
            )
    return {name: np.broadcast_to(array, count).copy() for name, array in arrays.items()}
