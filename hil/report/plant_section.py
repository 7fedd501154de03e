"""Sections about the identified plant and its FMUs: modes, errors, parameters, checks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import PERIOD_S
from firmware_py.core.units import (
    ANGLE,
    FILE_SIZE,
    FRACTION,
    LENGTH,
    PAYLOAD,
    error_unit,
    signal_words,
    symbol_of,
)
from firmware_py.link.link_description import STUDY_LINK
from hil.report.build_inputs import FmuCheckOutput
from models.plant.document import Evaluation, SignalError, TipError
from models.plant.linear_twin import LinearTwins, modes, tip_part
from models.plant.plant import Plant
from models.shared.drawing import Drawing, Line, log_axis, plot_lines
from models.shared.pages import (
    NO_VALUE,
    Cell,
    Figure,
    Folded,
    LegendEntry,
    Panel,
    Part,
    Table,
    TableCell,
    value_text,
)
from models.shared.palette import ordered_colours

Array = NDArray[np.float64]
Response = NDArray[np.complex128]

LEAST_SHARE: Final = 0.05
"""Least share of the link's bend of a mode that is shown [assumed]."""
PER_DEGREE: Final = LENGTH.factor / ANGLE.factor
"""From m/rad to mm per degree."""


def plant_parts(plant: Plant | None, evaluations: Mapping[str, Evaluation]) -> list[Part]:
    parts: list[Part] = []
    if plant is not None and plant.load == "link":
        parts += linear_parts(plant)
    if evaluations:
        parts += _evaluation_tables(evaluations)
    if plant is not None and (fitted := _parameter_table(plant)):
        parts.append(Folded(f"{len(fitted.rows)} identified parameters", [fitted]))
    return parts


def linear_parts(plant: Plant) -> list[Part]:
    """Bode plot of the twin from the goal of joint 1 to tip x, and its modes, by payload."""
    heaviest_kg = (plant.link or STUDY_LINK).payload_kg
    payloads_kg = list(dict.fromkeys([0.0, heaviest_kg / 2, heaviest_kg]))
    twins = LinearTwins(plant.step_model(1), PERIOD_S)
    frequency_hz = np.geomspace(0.1, 0.9 * 0.5 / PERIOD_S, 400)
    z = np.exp(2j * np.pi * frequency_hz * PERIOD_S)
    curves, marks, legend, rows = [], [], [], list[list[Cell]]()
    for payload_kg, colour in zip(payloads_kg, ordered_colours(len(payloads_kg)), strict=True):
        system = twins.at(payload_kg)
        response = np.asarray(tip_part(system)(z, squeeze=False))[0, 0]
        curves.append((PER_DEGREE * response, colour))
        legend.append(LegendEntry(colour, PAYLOAD.significant(payload_kg)))
        for mode in modes(system):
            if mode.damping < 1.0 and mode.shares[0] >= LEAST_SHARE:
                mode_hz = mode.frequency_rad_s / (2 * np.pi)
                marks.append((mode_hz, colour))
                rows.append(
                    [PAYLOAD.significant(payload_kg), f"{mode_hz:.2f}",
                     FRACTION.number(mode.damping, 1), FRACTION.number(mode.shares[0])]
                )  # fmt: skip
    figure = Figure(
        "Bode plot of the twin",
        "From the goal of joint 1 to tip x, linearised about rest at angle zero with the joint in "
        "motion; dotted: modes in which the link bends.",
        _bode_panels(frequency_hz, curves, marks),
        legend=legend,
    )
    header = ["payload", "frequency in Hz", "damping ratio in %", "share of the link's bend in %"]
    return [figure, Table("Modes", header, rows)] if rows else [figure]


def _bode_panels(
    frequency_hz: Array, curves: Sequence[tuple[Response, str]], marks: Sequence[tuple[float, str]]
) -> list[Panel]:
    """Gain and phase of each response in its colour; marked frequencies are vertical lines."""
    gains = [np.abs(response) for response, _ in curves]
    phases = [ANGLE.shown(np.unwrap(np.angle(response))) for response, _ in curves]
    panels = []
    for title, values, ylabel in (
        ("Gain", gains, "tip x, mm per degree"), ("Phase", phases, ANGLE.label("phase")),
    ):  # fmt: skip
        with Drawing() as (drawing, ax):
            for mark_hz, colour in marks:
                ax.axvline(mark_hz, color=colour, linestyle=":", linewidth=1)
            lines = zip(values, curves, strict=True)
            plot_lines(ax, [Line(frequency_hz, y, colour, width=1.2) for y, (_, colour) in lines])
            log_axis(ax, frequency_hz, "x")
            ax.set(xlabel="frequency in Hz", ylabel=ylabel)
            if title == "Gain":
                log_axis(ax, np.concatenate(values))
            else:
                _degrees(ax)
        alt = f"{title} of tip x per goal, by payload over frequency."
        panels.append(drawing.panel(title, alt))
    return panels


def _degrees(ax: Any) -> None:
    """Ticks of a phase at multiples of 45°, or of 90° if it turns far."""
    low, high = ax.get_ylim()
    step = 45 if high - low < 300 else 90 if high - low < 700 else 180
    ax.set_yticks(np.arange(step * math.floor(low / step), high + step, step))
    ax.set_ylim(low, high)


def _evaluation_tables(evaluations: Mapping[str, Evaluation]) -> list[Part]:
    """Errors of the tip, with rigid kinematics as baseline, and of every signal."""
    columns = {
        f"{title}, {dof}DOF": part
        for title, evaluation in evaluations.items()
        for dof, part in evaluation.dof.items()
    }
    parts = columns.values()
    tip: list[list[Cell]] = [
        [name, value_text(part.tip_rms_m, LENGTH), value_text(part.rigid_tip_rms_m, LENGTH)]
        for name, part in columns.items()
    ]
    of_payload: list[list[Cell]] = [
        [f"{kg} kg", *(_beside_rigid(part.payloads.get(kg)) for part in parts)]
        for kg in dict.fromkeys(kg for part in parts for kg in part.payloads)
    ]
    of_signals: list[list[Cell]] = [
        [signal_words(name), *(_signal_error(part.signals.get(name)) for part in parts)]
        for name in sorted({name for part in parts for name in part.signals})
    ]
    title = "Tip of the plant on trials that it was not fitted to, RMS error"
    note = "Rigid kinematics: a link that does not bend, at the measured angles."
    head = ["", *columns]
    folded: list[Table] = []
    if of_payload:
        with_rigid = "RMS error, in brackets that of rigid kinematics."
        folded.append(Table("Tip by payload", head, of_payload, with_rigid))
    with_mean = "RMS error, in brackets the mean absolute error."
    folded.append(Table("Signals", head, of_signals, with_mean))
    return [
        Table(title, ["trials", "plant", "rigid kinematics"], tip, note),
        Folded("Errors by payload and signal", folded),
    ]


def _signal_error(error: SignalError | None) -> str:
    if error is None:
        return NO_VALUE
    unit = error_unit(error.unit)
    return f"{unit.significant(error.rms)} ({unit.factor * error.mae:.3g})"


def _beside_rigid(error: TipError | None) -> str:
    if error is None or error.tip_rms_m is None or error.rigid_tip_rms_m is None:
        return NO_VALUE
    return f"{LENGTH.text(error.tip_rms_m)} ({LENGTH.number(error.rigid_tip_rms_m)})"


def _parameter_table(plant: Plant) -> Table | None:
    """Identified parameters with standard errors; None if nothing was fitted."""
    rows = []
    for name in plant.provenance.fitted_parameters:
        if q := plant.parameters.get(name):
            value = f"{q.value:.4g}".replace("-", "−")
            error = NO_VALUE if q.error is None else f"{q.error:.2g}"
            rows.append([name, value, error, symbol_of(q.unit)])
    return Table("", ["", "value", "standard error", "unit"], rows) if rows else None


def fmu_parts(checks: Mapping[str, FmuCheckOutput]) -> list[Part]:
    if not checks:
        return []
    each = checks.values()
    steps = dict.fromkeys(how for check in each for how in check.step_us)
    kinds = dict.fromkeys(c.name for check in each for c in check.checks)
    rows: list[list[Cell]] = [
        ["FMI", *(str(check.fmi) for check in each)],
        ["size", *(FILE_SIZE.text(check.bytes) for check in each)],
    ]
    for how in steps:
        words = f"time of a step, {how.replace('_', ' ')}"
        rows.append([words, *(_step_time(check, how) for check in each)])
    rows += [[kind, *(_check_cell(check, kind) for check in each)] for kind in kinds]
    return [Table("", ["", *checks], rows, "Checks of dropstitch fmu check.")]


def _step_time(check: FmuCheckOutput, how: str) -> str:
    return f"{check.step_us[how]:.0f}\u00a0µs" if how in check.step_us else NO_VALUE


def _check_cell(check: FmuCheckOutput, kind: str) -> Cell:
    results = [c for c in check.checks if c.name == kind]
    details = "; ".join(dict.fromkeys(c.detail for c in results))
    return TableCell(details, all(c.passed for c in results)) if results else NO_VALUE
