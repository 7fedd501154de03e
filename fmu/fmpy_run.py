"""Simulation of an FMU in FMPy along a motion or a trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from firmware_py.core.signals import DI, PAYLOAD, tip_names
from fmu.fmpy_instance import FmpyInstance, FmuArchive
from fmu.fmu_models import embedded_parts
from fmu.stimulus import (
    check_link_of_trial,
    inputs_from_motion,
    inputs_from_trial,
    usual_payload_kg,
)
from models.plant.step_model import names
from models.trials.deformation import deformation_index
from models.trials.trial import Trial

__all__ = ["FmuRun", "simulate_fmu"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FmuRun:
    """Inputs and outputs of a simulated FMU.

    Attributes
    ----------
    title : str
        Name of the FMU, and source of the inputs.
    time_s : ndarray, shape (n,)
        Time of each row.
    columns : dict of str to ndarray, shape (n,)
        Inputs, then outputs, by name. As in a trial, a goal is sent just after its row's sample.
    units : dict of str to str
        SI unit of each column.
    measured : dict of str to ndarray, shape (n,)
        Measured values of the outputs by name, if the inputs come from a trial.
    """

    title: str
    time_s: Array
    columns: dict[str, Array]
    units: dict[str, str]
    measured: dict[str, Array]

    def rms_against_trial(self) -> dict[str, float]:
        """Return the RMS error against the trial by output, in the unit of each.

        Returns
        -------
        dict of str to float
            RMS error by name of the output; empty if the inputs come from a motion.
        """
        return {
            name: float(np.sqrt(np.mean((self.columns[name] - values) ** 2)))
            for name, values in self.measured.items()
        }


def simulate_fmu(
    archive: FmuArchive,
    source: Motion | Trial,
    payload_kg: float | None,
    step_s: float,
    parameters: Mapping[str, float],
) -> FmuRun:
    """Simulate an FMU in FMPy.

    Parameters
    ----------
    archive : FmuArchive
        Unpacked FMU.
    source : Motion or Trial
        Source of the inputs.
    payload_kg : float or None
        Payload at the tip for a motion; None for half of the link's largest. For a trial, the
        trial's payload is used.
    step_s : float
        Communication step for a motion. For a trial, the trial's time step is used.
    parameters : mapping of str to float
        Values of variables to set before the start, in SI units.

    Returns
    -------
    FmuRun
        Inputs and outputs at each time.

    Raises
    ------
    InputError
        If `dropstitch` did not build the FMU, if the FMU refuses a parameter, an input or a step,
        or if the trial is of another link.
    """
    parts = embedded_parts(archive.directory / "resources")
    if parts is None:
        raise InputError(
            archive.path, "carries no parts of ours", "give one that 'dropstitch fmu build' wrote"
        )
    model = parts.model()
    inputs, outputs = names(model.inputs), names(model.outputs)
    if isinstance(source, Trial):
        check_link_of_trial(parts, source, parameters)
        u, step_s = inputs_from_trial(parts, model, source), source.step_s
    else:
        held_kg = usual_payload_kg(parts) if payload_kg is None else payload_kg
        u = inputs_from_motion(parts, model, replace(source, dof=parts.dof), held_kg, step_s)
    # A goal holds during the step after it; a measured sample is taken at the end of a step.
    goals = parts.kind == "twin"
    with archive.instance() as instance:
        _set(archive, instance, parameters)
        driven = u[:-1] if goals else u
        try:
            y = instance.run(inputs, driven, np.full(len(driven), step_s), outputs)
        except FMICallException:
            raise _refusal(archive, instance) from None
    y = y if goals else y[1:]
    return FmuRun(
        title=f"{archive.path.name}: {source.name if isinstance(source, Trial) else source.kind}",
        time_s=np.asarray(step_s * np.arange(len(u), dtype=np.float64)),
        columns=dict(zip([*inputs, *outputs], [*u.T, *y.T], strict=True)),
        units={v.name: v.unit for v in (*model.inputs, *model.outputs)},
        measured=_measured(source, outputs) if isinstance(source, Trial) else {},
    )


def _set(archive: FmuArchive, instance: FmpyInstance, parameters: Mapping[str, float]) -> None:
    for name, value in parameters.items():
        if name not in instance.variables:
            raise InputError(archive.path, f"has no variable {name}", "see its documentation")
        try:
            instance.set({name: value})
        except FMICallException:
            raise _refusal(archive, instance) from None


def _refusal(archive: FmuArchive, instance: FmpyInstance) -> InputError:
    """Error of the user's input with the FMU's last message."""
    return InputError(archive.path, instance.messages[-1].rstrip("."), "choose another value")


def _measured(trial: Trial, outputs: Sequence[str]) -> dict[str, Array]:
    """Measured values of the outputs; the predicted tip is compared with the measured tip."""
    columns = {**trial.columns, DI.name: deformation_index(trial)}
    columns[PAYLOAD.name] = np.full(len(trial), trial.meta.payload_kg)
    for name, predicted in zip(tip_names(), tip_names("predicted_"), strict=True):
        columns[predicted] = columns[name]
    return {name: columns[name] for name in outputs if name in columns}
