"""Compiled form of a `StepModel`: C code that runs a whole trial in one call.

The compiled run equals the interpreted `StepModel.simulate` to rounding (CasADi generates the same
operations; docs/sources.md, "FMI"). Libraries are cached by content, so a plant is compiled once.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from models.plant.simulation.model_c import write_model_c
from models.plant.simulation.start_of_motion import start_of_motion
from models.plant.step_model import StepModel, names
from models.shared.c_compiler import load_library
from models.trials.trial import Trial

__all__ = [
    "CompiledModel",
    "model_inputs",
    "run_trial",
    "trial_inputs",
    "trial_parameters",
]

Array = NDArray[np.float64]
_DRIVER: Final = Path(__file__).with_name("run_trial.c")
_POINTER: Final = ctypes.POINTER(ctypes.c_double)


class CompiledModel:
    """A `StepModel` compiled to run whole trials."""

    def __init__(self, model: StepModel) -> None:
        self.model = model
        sizes = {"N_X": len(model.states), "N_U": len(model.inputs), "N_Y": len(model.outputs)}
        self._library = load_library(
            lambda directory: [write_model_c(model, directory), _DRIVER],
            flags=[f"-D{name}={size}" for name, size in sizes.items()],
        )

    def start(self, u: Array, p: Array) -> Array:
        """Initial state under inputs u of shape (len(inputs),) and parameters p."""
        x = np.empty(len(self.model.states))
        self._call("start", np.ascontiguousarray(u, dtype=np.float64), p, x)
        return x

    def simulate(
        self, u: Array, step_s: float, p: Array | None = None, x: Array | None = None
    ) -> Array:
        """Outputs at the start and after each step, shape (n + 1, len(outputs)).

        Row k is the output at k * step_s.
        """
        u = np.ascontiguousarray(u, dtype=np.float64)
        p = np.asarray(self.model.parameter_values() if p is None else p, dtype=np.float64)
        x = self.start(u[0], p) if x is None else np.array(x, dtype=np.float64)
        y = np.empty((len(u) + 1, len(self.model.outputs)))
        times = (ctypes.c_double(step_s), ctypes.c_double(self.model.max_substep_s))
        self._call("run", u, p, x, y, before=(ctypes.c_long(len(u)), *times))
        return y

    def _call(self, function: str, *arrays: Array, before: tuple[Any, ...] = ()) -> None:
        pointers = [a.ctypes.data_as(_POINTER) for a in arrays]
        if getattr(self._library, function)(*before, *pointers):
            raise MemoryError(f"{self.model.name}: {function}")


def trial_parameters(model: StepModel, trial: Trial) -> Array:
    """Parameter vector: the plant's values, with the trial's geometry, conditions and start."""
    dimensions = ("base_offset_m", "link_length_m", "link_width_m")
    own = {n: getattr(trial.meta, n) for n in dimensions if trial.meta.link_length_m}
    own |= trial.meta.conditions
    for j in range(1, trial.meta.dof + 1):
        for position, angle in ((f"angle_{j}_rad", "rad"), (f"position_{j}_m", "m")):
            if position in trial.columns:
                goal = trial.columns.get(f"goal_{j}_{angle}", np.zeros(1))
                own[f"start_offset_{j}_{angle}"] = trial.columns[position][0] - goal[0]
                own[f"start_joint_rate_{j}_{angle}_s"] = start_of_motion(trial, position)[1]
        deflection = f"deflection_{j}_rad"
        if deflection in trial.columns:
            start, rate = start_of_motion(trial, deflection)
            own |= {f"start_{deflection}": start, f"start_deflection_rate_{j}_rad_s": rate}
    known = set(names(model.parameters))
    return model.parameter_values({n: v for n, v in own.items() if n in known})


def model_inputs(model: StepModel, trial: Trial) -> Array:
    """Inputs of a model from a trial's columns, shape (n, len(inputs)).

    The payload is the declared one. A drive is enabled unless a column says otherwise.
    """
    columns = dict(trial.columns)
    for j in range(1, trial.meta.dof + 1):
        columns.setdefault(f"enabled_{j}", np.ones(len(trial)))
    columns.setdefault("payload_kg", np.full(len(trial), trial.meta.payload_kg))
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
