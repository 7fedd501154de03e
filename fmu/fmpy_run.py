"""Run of an FMU in FMPy along a motion or a trial: inputs, simulation, table and plot."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from firmware_py.core import units as display_units
from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from firmware_py.core.signals import AGE, DI, PAYLOAD, PERIOD_S, TIME, observer_signals, tip_names
from firmware_py.link.link_description import STUDY_LINK
from fmu.fmpy_instance import FmpyInstance, FmuArchive
from fmu.fmu_models import FmuParts, embedded_parts
from models.plant.identification.doubts import differences_from_plant
from models.plant.simulation.runner import model_inputs
from models.plant.step_model import StepModel, names
from models.shared.palette import SERIES
from models.trials.deformation import deformation_index
from models.trials.trial import LINK_SIZES, Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FmuRun", "simulate_fmu"]

Array = NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class FmuRun:
    """Inputs and outputs of a simulated FMU; `simulate_fmu` makes it.

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
    inputs : tuple of str
        Names of the columns that are inputs.

    Examples
    --------
    >>> time_s = 0.1 * np.arange(3)
    >>> columns = {"goal_1_rad": np.zeros(3), "angle_1_rad": np.full(3, 0.01)}
    >>> units = {"goal_1_rad": "rad", "angle_1_rad": "rad"}
    >>> run = FmuRun("toy", time_s, columns, units, {"angle_1_rad": np.zeros(3)}, ("goal_1_rad",))
    >>> run
    <FmuRun toy: 3 rows of 100 ms, 1 input, 1 output>
    >>> run.rms_against_trial()
    {'angle_1_rad': 0.01}
    """

    title: str
    time_s: Array
    columns: dict[str, Array]
    units: dict[str, str]
    measured: dict[str, Array]
    inputs: tuple[str, ...] = ()

    def __repr__(self) -> str:
        inputs, outputs = len(self.inputs), len(self.columns) - len(self.inputs)
        step_ms = 1e3 * float(self.time_s[1] - self.time_s[0])
        return (
            f"<FmuRun {self.title}: {len(self.time_s)} rows of {step_ms:.3g} ms, "
            f"{inputs} input{'s' * (inputs != 1)}, {outputs} output{'s' * (outputs != 1)}>"
        )

    def plot(self) -> Figure:
        """Draw inputs and outputs over time; what a trial measured is dashed."""
        return _plot(self)

    def write(self, path: Path | str) -> Path:
        """Write time, inputs and outputs as CSV in SI units, one row per step."""
        columns = [self.time_s, *self.columns.values()]
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow([TIME.name, *self.columns])
            writer.writerows([repr(float(v)) for v in row] for row in zip(*columns, strict=True))
        return Path(path)

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
    file: Path | str | FmuArchive,
    source: Motion | Trial | None = None,
    payload_kg: float | None = None,
    step_s: float = PERIOD_S,
    parameters: Mapping[str, float] = MappingProxyType({}),
) -> FmuRun:
    """Simulate an FMU of `build_fmu` in FMPy.

    Parameters
    ----------
    file : Path, str or FmuArchive
        The .fmu file, or an unpacked one.
    source : Motion or Trial, optional
        Source of the inputs; by default the study's sinusoid.
    payload_kg : float, optional
        Payload at the tip for a motion; by default half of the link's largest. For a trial, the
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

    Examples
    --------
    >>> import dropstitch
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     twin = dropstitch.build_fmu(dropstitch.read_plant(), f"{directory}/twin.fmu")
    ...     light = dropstitch.simulate_fmu(twin, payload_kg=0.0)
    ...     heavy = dropstitch.simulate_fmu(twin, payload_kg=2.0)
    >>> bool(heavy.columns["tip_x_m"].max() > light.columns["tip_x_m"].max())
    True
    """
    if isinstance(file, FmuArchive):
        return _simulated(file, source or Motion(), payload_kg, step_s, parameters)
    with FmuArchive(file) as archive:
        return _simulated(archive, source or Motion(), payload_kg, step_s, parameters)


def _simulated(
    archive: FmuArchive,
    source: Motion | Trial,
    payload_kg: float | None,
    step_s: float,
    parameters: Mapping[str, float],
) -> FmuRun:
    parts = embedded_parts(archive.directory / "resources")
    if parts is None:
        raise InputError(
            archive.path,
            "contains no plant or bundle",
            "give one that 'dropstitch fmu build' wrote",
        )
    model = parts.model()
    inputs, outputs = names(model.inputs), names(model.outputs)
    if isinstance(source, Trial):
        check_link_of_trial(parts, source, parameters)
        u, step_s = inputs_from_trial(parts, model, source), source.step_s
    else:
        if payload_kg is None:
            payload_kg = usual_payload_kg(parts)
        u = inputs_from_motion(parts, model, replace(source, dof=parts.dof), payload_kg, step_s)
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
        inputs=tuple(inputs),
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


# ---- Inputs -------------------------------------------------------------------------------------


def usual_payload_kg(parts: FmuParts) -> float:
    """Return the default payload: half of the largest that the link of the plant carries."""
    link = parts.plant.link if parts.plant else None
    return (link or STUDY_LINK).payload_kg / 2


def check_link_of_trial(parts: FmuParts, trial: Trial, parameters: Mapping[str, float]) -> None:
    """Refuse a trial of another link than the FMU's, if the FMU has the plant of a link."""
    plant = parts.plant
    if plant is None or plant.load != "link":
        return
    start = {
        q: parameters[key] for q in plant.parameters if (key := f"parameters.{q}") in parameters
    }
    for name, of_trial, of_fmu in differences_from_plant(trial.meta, plant.with_values(start)):
        change = "build the FMU from a plant of this link"
        if name in LINK_SIZES:
            change = f"pass --set parameters.{name}={of_trial}"
        raise InputError(
            trial.path,
            f"is of another link than the FMU: {name} {of_trial} instead of {of_fmu}",
            f"give a trial of the FMU's link, or {change}",
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


# ---- Figure --------------------------------------------------------------------------------------


def _plot(run: FmuRun) -> Figure:
    """Plot a run, one panel per quantity; trial dashed, predictions dotted."""
    import matplotlib.pyplot as plt  # a campaign's cases draw nothing

    from models.shared.drawing import FILE_STYLE

    figure: Figure
    panels = panels_by_quantity(run.columns, run.units)
    with plt.rc_context(FILE_STYLE):
        figure, axes = plt.subplots(
            len(panels), 1, figsize=(8.0, 2.2 * len(panels)), sharex=True, squeeze=False,
            layout="constrained",
        )  # fmt: skip
        for ax, ((quantity, unit), shown) in zip(axes[:, 0], panels.items(), strict=True):
            columns = {name: run.columns[name] for name in shown}
            plot_panel(
                ax, run.time_s, columns, quantity, unit, run.measured, display_units.si_unit(unit)
            )
            ax.set_xlabel("")
            ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes[0, 0].set_title(run.title)
        axes[-1, 0].set_xlabel(display_units.TIME.label("time"))
        plt.close(figure)
    return figure


def panels_by_quantity(
    columns: Mapping[str, Array], units: Mapping[str, str]
) -> dict[tuple[str, str], list[str]]:
    panels: dict[tuple[str, str], list[str]] = {}
    for name in columns:
        panels.setdefault((_quantity(name), units[name]), []).append(name)
    return panels


def plot_panel(
    ax: Any,
    time_s: Array,
    columns: Mapping[str, Array],
    quantity: str,
    unit: str,
    measured: Mapping[str, Array] | None = None,
    shown: display_units.DisplayUnit | None = None,
) -> None:
    """Plot the columns of one panel, measured values dashed, predictions dotted.

    Without a unit in which they are `shown`, it is the one for pages.
    """
    if shown is None:
        shown = display_units.DEFORMATION if "di" in columns else display_units.value_unit(unit)
    variables = list(dict.fromkeys(name.removeprefix("predicted_") for name in columns))
    for name, values in columns.items():
        predicted = name not in variables
        colour = SERIES[variables.index(name.removeprefix("predicted_")) % len(SERIES)]
        style = ":" if predicted else "-"
        ax.plot(time_s, shown.shown(values), style, lw=1.0, color=colour, label=name)
        if measured and name in measured and not predicted:  # tip and predicted tip share it
            ax.plot(
                time_s, shown.shown(measured[name]), "--", lw=1.0, color=colour, alpha=0.5,
                label=f"{name}, trial",
            )  # fmt: skip
    ax.set(ylabel=shown.label(quantity), xlabel=display_units.TIME.label("time"))


def _quantity(name: str) -> str:
    """Quantity of a variable; for "tip_x_m" and "predicted_tip_x_m" it is the tip."""
    if name == "di":
        return "DI"
    for quantity in (
        "half_width",
        "deviation",
        "tip",
        "angle",
        "goal",
        "current",
        "payload",
        "in_range",
    ):
        if quantity in name:
            return {"goal": "angle", "half_width": "half width"}.get(quantity, quantity)
    return name
