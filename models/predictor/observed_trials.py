"""Rows for tip predictors: trials with the observer that ran along them, stacked.

The observer is the step model of a plant, the one whose FMU runs on the robot. To calibrate the
interval it runs along the same trials with deliberately wrong plants, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.signals import AGE, feature_names, observer_signals, tip_names
from models.plant.simulation.runner import CompiledModel, model_inputs
from models.plant.step_model import StepModel, names
from models.predictor.onnx_graphs import Array
from models.shared.kinematics import base_rotation
from models.trials.trial import Trial


def observe(
    observer: CompiledModel, trials: Sequence[Trial], changes: Mapping[str, float] | None = None
) -> list[dict[str, Array]]:
    """Outputs of the observer along each trial, from its first row at rest on.

    Row k is the output after the step that ends at sample k, as on the robot. The geometry is the
    plant's, not the trial's. `changes`: values of parameters of a wrong plant.
    """
    model = observer.model
    p: Array = model.parameter_values(changes)
    runs = [observer.simulate(model_inputs(model, t), t.step_s, p)[1:] for t in trials]
    return [dict(zip(names(model.outputs), y.T, strict=True)) for y in runs]


def wrong_plants(model: StepModel) -> dict[str, dict[str, float]]:
    """Changed parameters of the wrong plants for which the interval is calibrated, by name.

    A stiffness that is 20 % off is the largest error of a plant that must be detected.
    """
    stiffness = {v.name: v.start for v in model.parameters if "_stiffness_" in v.name}
    if not stiffness:
        return {}
    return {
        f"stiffness_x_{factor:g}": {name: factor * value for name, value in stiffness.items()}
        for factor in (0.8, 1.2)
    }


def input_names(dof: int) -> tuple[str, ...]:
    """Inputs of every candidate: measured signals, their age, and signals of the observer."""
    return (*feature_names(dof), AGE.name, *(signal.name for signal in observer_signals(dof)))


@dataclass(frozen=True)
class TipRows:
    """Rows of several trials, stacked."""

    names: tuple[str, ...]  # Names of the input columns
    inputs: Array  # (n, inputs)
    tip_m: Array  # (n, 3), end effector by motion capture
    payload_kg: Array  # (n,)
    motion: NDArray[np.str_]  # (n,)
    run: NDArray[np.intp]  # (n,), index of the trial
    part: NDArray[np.str_]  # (n,), "rest" or "motion"
    wrong_inputs: tuple[Array, ...] = ()  # Inputs with an observer of each wrong plant
    askew_m: tuple[Array, ...] = ()  # (n, 3) each, shift of the tip of a link mounted askew

    def __len__(self) -> int:
        return len(self.run)

    def columns(self, names: Sequence[str]) -> list[int]:
        return [self.names.index(name) for name in names]

    def of(self, names: Sequence[str]) -> Array:
        return self.inputs[:, self.columns(names)]

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> TipRows:
        return TipRows(
            self.names, self.inputs[rows], self.tip_m[rows], self.payload_kg[rows],
            self.motion[rows], self.run[rows], self.part[rows],
            tuple(a[rows] for a in self.wrong_inputs), tuple(a[rows] for a in self.askew_m),
        )  # fmt: skip

    @property
    def dof(self) -> int:
        return 2 if "angle_2_rad" in self.names else 1

    @property
    def observer_tip_m(self) -> Array:
        return self.of(tip_names())

    def with_askew_mount(self, askew_rad: float) -> TipRows:
        """Rows with the shifts of the tip in both directions in the plane of each joint."""
        if askew_rad == 0.0:
            return self
        joints = range(1, self.dof + 1)
        turn = base_rotation(self.of([f"angle_{j}_rad" for j in joints]))
        # Joint 1 turns about y, joint 2 about -x (docs/architecture.md, "Physics").
        axes = {1: turn[:, :, 1], 2: -turn[:, :, 0]}
        shifts_m = (
            sign * askew_rad * np.cross(axes[j], self.tip_m) for j in joints for sign in (-1.0, 1.0)
        )
        return replace(self, askew_m=tuple(shifts_m))


def collect_rows(
    observer: CompiledModel, trials: Sequence[Trial], changes: Mapping[str, float] | None = None
) -> TipRows:
    """Stack the rows of trials, rest rows included; rows without a measured tip are dropped."""
    names, parts = input_names(trials[0].meta.dof), []
    for number, (trial, signals) in enumerate(
        zip(trials, observe(observer, trials, changes), strict=True)
    ):
        columns = {**trial.columns, **signals, AGE.name: np.zeros(len(trial))}
        if missing := [name for name in names if name not in columns]:
            raise InputError(
                "observer", f"has no output {missing[0]}, which the predictors want",
                "choose a plant of the link",
            )  # fmt: skip
        inputs = np.column_stack([columns[name] for name in names])
        rows = np.flatnonzero(np.isfinite(np.hstack([trial.tip_m, inputs])).all(axis=1))
        parts.append((
            inputs[rows], trial.tip_m[rows], np.full(len(rows), trial.meta.payload_kg),
            np.full(len(rows), trial.meta.motion), np.full(len(rows), number, dtype=np.intp),
            np.where(rows >= trial.meta.rest_samples, "motion", "rest"),
        ))  # fmt: skip
    inputs, tip_m, payload_kg, motion, run, part = map(np.concatenate, zip(*parts, strict=True))
    return TipRows(names, inputs, tip_m, payload_kg, motion, run, part)
