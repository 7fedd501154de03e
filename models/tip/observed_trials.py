"""Trials with the signals of their observer, also of observers with a deliberately wrong plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from models.learning.predictors import Array
from models.plant.simulation.compiled_model import CompiledModel, model_inputs
from models.plant.step_model import StepModel, names
from models.shared.kinematics import base_rotation
from models.tip.tip_rows import ObservedTrial, TipRows
from models.trials.trial import Trial

__all__ = ["ASKEW_RAD", "WRONG_STIFFNESS", "askew_shifts_m", "observe", "wrong_stiffness"]

WRONG_STIFFNESS: Final = (0.8, 1.2)
"""Factors on the stiffness of the observer's plant, for the calibration of the interval: the
largest error of a plant that must be detected."""


ASKEW_RAD: Final = 0.005
"""Angle by which the link may be mounted askew, for the calibration of the interval: 0.3°, 5 mm at
the tip [assumed] for a link that is taken off and mounted again by hand. `train --askew-deg`
sets another; 0 ignores this error, which the servos cannot measure."""


def observe(
    compiled: CompiledModel, trials: Sequence[Trial], changes: Mapping[str, float] | None = None
) -> list[ObservedTrial]:
    """Run the observer along trials.

    Row k is the output after the step that ends at sample k, as on the robot. The geometry is the
    plant's, not the trial's.
    """
    model, found = compiled.model, []
    p: Array = model.parameter_values(changes)
    for trial in trials:
        y = compiled.simulate(model_inputs(model, trial), trial.step_s, p)[1:]
        signals = dict(zip(names(model.outputs), np.ascontiguousarray(y.T), strict=True))
        found.append(ObservedTrial(trial, signals))
    return found


def wrong_stiffness(model: StepModel, factor: float) -> dict[str, float]:
    """Values of all stiffness parameters times a factor."""
    return {v.name: factor * v.start for v in model.parameters if "_stiffness_" in v.name}


def askew_shifts_m(rows: TipRows, askew_rad: float = ASKEW_RAD) -> list[Array]:
    """Shift of the tip of a link that is mounted askew, (n, 3) each; empty for an angle of zero.

    One shift for either direction in the plane of each joint.
    """
    if askew_rad == 0.0:
        return []
    joints = range(1, rows.dof + 1)
    angles_rad = rows.of([f"angle_{j}_rad" for j in joints])
    turn = base_rotation(angles_rad)
    # Joint 1 turns about y, joint 2 about -x (docs/architecture.md, "Physics").
    axes = {1: turn[:, :, 1], 2: -turn[:, :, 0]}
    return [
        sign * askew_rad * np.cross(axes[j], rows.tip_m) for j in joints for sign in (-1.0, 1.0)
    ]
