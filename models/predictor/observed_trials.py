"""Rows for tip predictors: trials with the observer that ran along them, stacked.

The observer is the step model of a plant, the one whose FMU runs on the robot. To calibrate the
interval it runs along the same trials with deliberately wrong plants, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.signals import AGE, feature_names, observer_signals, tip_names
from models.plant.simulation.runner import CompiledModel, model_inputs
from models.plant.step_model import StepModel, names
from models.predictor.onnx_graphs import Array
from models.shared.kinematics import base_rotation
from models.trials.trial import Trial

WRONG_STIFFNESS: Final = (0.8, 1.2)
"""Factors on the stiffness of the observer's plant, for the calibration of the interval: the
largest error of a plant that must be detected."""
ASKEW_RAD: Final = 0.005
"""Angle by which the link may be mounted askew, for the calibration of the interval: 0.3°, 5 mm at
the tip [assumed] for a link that is taken off and mounted again by hand."""


class ObservedTrial(NamedTuple):
    """Trial with the outputs of the observer that ran along it."""

    trial: Trial
    signals: Mapping[str, Array]  # (n,), outputs of the observer after each sample


def observe(
    observer: CompiledModel, trials: Sequence[Trial], changes: Mapping[str, float] | None = None
) -> list[ObservedTrial]:
    """Run the observer along trials, from their first row at rest on.

    Row k is the output after the step that ends at sample k, as on the robot. The geometry is the
    plant's, not the trial's. `changes`: values of parameters of a wrong plant.
    """
    model, observed = observer.model, []
    p: Array = model.parameter_values(changes)
    for trial in trials:
        y = observer.simulate(model_inputs(model, trial), trial.step_s, p)[1:]
        observed.append(ObservedTrial(trial, dict(zip(names(model.outputs), y.T, strict=True))))
    return observed


def wrong_stiffness(model: StepModel, factor: float) -> dict[str, float]:
    """Values of all stiffness parameters times a factor."""
    return {v.name: factor * v.start for v in model.parameters if "_stiffness_" in v.name}


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
        )  # fmt: skip

    @property
    def dof(self) -> int:
        return 2 if "angle_2_rad" in self.names else 1

    @property
    def observer_tip_m(self) -> Array:
        return self.of(tip_names())


def collect_rows(observed: Sequence[ObservedTrial]) -> TipRows:
    """Stack the rows of trials, rest rows included; rows without a measured tip are left out."""
    names = input_names(observed[0].trial.meta.dof)
    parts = []
    for number, (trial, signals) in enumerate(observed):
        columns = {**trial.columns, **signals, AGE.name: np.zeros(len(trial))}
        if missing := [name for name in names if name not in columns]:
            raise InputError(
                "observer", f"has no output {missing[0]}, which the predictors want",
                "choose a plant of the link",
            )  # fmt: skip
        inputs = np.column_stack([columns[name] for name in names])
        seen = np.isfinite(trial.tip_m).all(axis=1) & np.isfinite(inputs).all(axis=1)
        count = int(seen.sum())
        moving = np.arange(len(trial)) >= trial.meta.rest_samples
        parts.append((
            inputs[seen], trial.tip_m[seen], np.full(count, trial.meta.payload_kg),
            np.full(count, trial.meta.motion), np.full(count, number, dtype=np.intp),
            np.where(moving, "motion", "rest")[seen],
        ))  # fmt: skip
    return TipRows(names, *map(np.concatenate, zip(*parts, strict=True)))


def askew_shifts_m(rows: TipRows, askew_rad: float) -> list[Array]:
    """Shift of the tip of a link that is mounted askew, (n, 3) each; empty for an angle of zero.

    One shift for either direction in the plane of each joint.
    """
    if askew_rad == 0.0:
        return []
    joints = range(1, rows.dof + 1)
    turn = base_rotation(rows.of([f"angle_{j}_rad" for j in joints]))
    # Joint 1 turns about y, joint 2 about -x (docs/architecture.md, "Physics").
    axes = {1: turn[:, :, 1], 2: -turn[:, :, 0]}
    return [
        sign * askew_rad * np.cross(axes[j], rows.tip_m) for j in joints for sign in (-1.0, 1.0)
    ]
