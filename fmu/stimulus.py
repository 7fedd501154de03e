"""Inputs of an FMU, from a reference motion or from the rows of a trial."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from firmware_py.core.signals import AGE, DI, PAYLOAD, PERIOD_S, observer_signals
from firmware_py.link.link_description import STUDY_LINK
from fmu.fmu_models import FmuParts
from models.plant.identification.doubts import ALIKE_M_S2, SAME_SIZE_FRACTION
from models.plant.simulation.runner import model_inputs
from models.plant.step_model import StepModel, names
from models.trials.deformation import deformation_index
from models.trials.trial import Trial

Array = NDArray[np.float64]


def usual_payload_kg(parts: FmuParts) -> float:
    """Return the default payload: half of the largest that the link of the plant carries."""
    link = parts.plant.link if parts.plant else None
    return (link or STUDY_LINK).payload_kg / 2


def check_link_of_trial(parts: FmuParts, trial: Trial, parameters: Mapping[str, float]) -> None:
    """Refuse a trial of another link than the FMU's, if the FMU has the plant of a link."""
    plant, meta = parts.plant, trial.meta
    if plant is None or plant.load != "link" or not meta.link_length_m:
        return

    def own(name: str) -> float:
        return parameters.get(f"parameters.{name}", plant.parameters[name].value)

    for name in ("link_length_m", "link_width_m", "base_offset_m"):
        size_m = getattr(meta, name)
        if abs(size_m - own(name)) > SAME_SIZE_FRACTION * meta.link_length_m:
            raise InputError(
                trial.path,
                f"is of another link than the FMU: {name} {size_m:g} in place of {own(name):g}",
                f"give a trial of the FMU's link, or pass --set parameters.{name}={size_m:g}",
            )
    unit = (plant.link or STUDY_LINK).gravity.unit
    gravity = tuple(own("gravity_m_s2") * axis for axis in unit)
    if math.dist(gravity, meta.gravity) > ALIKE_M_S2:
        there, here = (
            "[" + ", ".join(f"{part + 0.0:.3g}" for part in vector) + "]"  # no -0
            for vector in (meta.gravity, gravity)
        )
        raise InputError(
            trial.path,
            f"is of a link that is mounted otherwise than the FMU's: gravity_m_s2 {there} in place "
            f"of {here}",
            "give a trial of the FMU's link, or build the FMU from a plant of this link",
        )


def inputs_from_motion(
    parts: FmuParts,
    model: StepModel,
    motion: Motion,
    payload_kg: float,
    step_s: float = PERIOD_S,
    rows: int | None = None,
) -> Array:
    """Make the inputs of an FMU from a motion, shape (n, inputs); row k drives step k.

    A twin gets the goals. An observer gets angles and currents of the twin of the same plant, with
    age zero. A predictor gets the goals as angles; its currents and DI sweep through typical
    values. `rows` limits the inputs to the first rows of the motion.
    """
    goal_rad = motion.table_rad(step_s)
    if parts.kind == "predictor":
        return _sweep(model, goal_rad)[:rows]
    goal_rad = goal_rad[:rows]
    columns = {f"goal_{j + 1}_rad": goal_rad[:, j] for j in range(parts.dof)}
    columns[PAYLOAD.name] = np.full(len(goal_rad), payload_kg)
    if parts.kind == "twin":
        return _columns(model, columns)
    twin = parts.required_plant().step_model(parts.dof, "twin")
    y = twin.simulate(_columns(twin, columns), step_s)[1:]
    columns = dict(zip(names(twin.outputs), y.T, strict=True))
    return _columns(model, columns | {AGE.name: np.zeros(len(y))})


def inputs_from_trial(parts: FmuParts, model: StepModel, trial: Trial) -> Array:
    """Make the inputs of an FMU from a trial, shape (n, inputs); row k drives step k.

    They are the trial's columns, its payload and, for a predictor, its true DI.
    """
    if trial.meta.dof != parts.dof:
        raise InputError(
            trial.path, f"is of {trial.meta.dof}DOF, the FMU of {parts.dof}DOF",
            f"give a trial of {parts.dof}DOF",
        )  # fmt: skip
    if parts.kind == "predictor":
        observed = set(names(model.inputs)) & {s.name for s in observer_signals(parts.dof)}
        if observed:
            raise InputError(
                trial.path, f"has no {min(observed)}, which an observer gives the predictor",
                "simulate the twin of the same bundle, which holds this predictor",
            )  # fmt: skip
        trial = replace(trial, columns={**trial.columns, DI.name: deformation_index(trial)})
    if parts.kind == "observer":
        trial = replace(trial, columns={**trial.columns, AGE.name: np.zeros(len(trial))})
    return model_inputs(model, trial)


def _columns(model: StepModel, columns: Mapping[str, Array]) -> Array:
    return np.column_stack([columns[name] for name in names(model.inputs)])


_AMPLITUDE: Final = {"A": 0.2, "kg": 1.0, "m": 0.1, "rad": 0.05, "rad/s": 0.3, "s": 0.01}
"""Amplitude of a predictor's inputs that are not measured, by unit [assumed]."""

REACH_M: Final = 1.0
"""Length of the rigid link whose tip stands for the observer's in the sweep [assumed]."""


def _sweep(model: StepModel, angle_rad: Array) -> Array:
    """Inputs of a predictor: the angles, and all other inputs as sinusoids of various frequencies.

    Currents reach 3 A, DI 1 %, the rest `_AMPLITUDE`; the tip is that of a rigid link.
    """
    count, dof = angle_rad.shape
    turn = 2.0 * np.pi * np.arange(count) / count
    columns = {
        v.name: _AMPLITUDE.get(v.unit, 0.0) * np.sin((k + 7) * turn)
        for k, v in enumerate(model.inputs)
    }
    columns |= {f"angle_{j + 1}_rad": angle_rad[:, j] for j in range(dof)}
    columns |= {f"current_{j + 1}_a": 3.0 * np.sin((j + 3) * turn) for j in range(dof)}
    columns[DI.name] = 0.005 * (1.0 - np.cos(5.0 * turn))
    columns["tip_x_m"] = REACH_M * np.sin(angle_rad[:, 0])
    return _columns(model, columns)
