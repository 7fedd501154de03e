"""Section on feedback in the page of plans: margins, Bode and Nyquist diagrams."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from firmware_py.core.units import ANGLE
from firmware_py.goals.tip_plan import TipPlan
from models.plan.feedback import (
    LEAST_GAIN_DB,
    LEAST_PHASE_RAD,
    Array,
    Response,
    frequencies,
    open_loops,
    tip_responses,
)
from models.plant.linear_twin import LinearTwins
from models.plant.plant import Plant
from models.shared.drawing import Drawing
from models.shared.pages import (
    Cell,
    Figure,
    LegendEntry,
    Panel,
    Paragraph,
    Part,
    Section,
    Table,
    TableCell,
)
from models.shared.palette import ALARM, INK, MUTED, ordered_colours

NYQUIST_HALF_WIDTH: Final = 1.3
"""Half of the side of the square in the complex plane that the Nyquist diagram shows."""


def feedback_section(plans: Mapping[int, TipPlan], plant: Plant | None) -> Section | None:
    """Return the section; None if no plan has feedback.

    The loops are drawn for the linearised twin of `plant`; without a plant there are no diagrams.
    """
    guided = {dof: plan for dof, plan in sorted(plans.items()) if plan.feedback is not None}
    if not guided:
        return None
    parts: list[Part] = [
        Paragraph(
            "Each loop is opened at its joint, with the other one closed. One period of delay "
            "stands for the loop and the bus. The margins are the least of sliding joints, "
            "joints at rest, and a link that is 20 % stiffer or softer than the plant says; the "
            "sliding one is drawn."
        ),
        _margin_table(guided),
    ]
    if plant is not None:
        for plan in guided.values():
            parts += _diagrams(plan, plant)
    return Section("feedback", "Feedback of the estimated tip", parts)


def _margin_table(plans: Mapping[int, TipPlan]) -> Table:
    rows: list[list[Cell]] = [
        [
            f"{dof}DOF, joint {joint}, {m.payload_kg:g} kg",
            TableCell(f"{m.gain_db:.1f}", bool(m.gain_db >= LEAST_GAIN_DB)),
            TableCell(ANGLE.number(m.phase_rad), bool(m.phase_rad >= LEAST_PHASE_RAD)),
            f"{m.crossover_rad_s:.1f}",
        ]
        for dof, plan in plans.items()
        if plan.feedback is not None
        for joint, own in enumerate(plan.feedback.margins, start=1)
        for m in own
    ]
    header = ["", "gain margin, dB", "phase margin, °", "crossover, rad/s"]
    targets = f"Targets: {LEAST_GAIN_DB:g} dB and {ANGLE.text(LEAST_PHASE_RAD, 0)}."
    return Table("Margins over the grid of payloads", header, rows, targets)


def _diagrams(plan: TipPlan, plant: Plant) -> list[Figure]:
    """Draw Bode and Nyquist diagrams of every joint, one curve for each payload."""
    if plan.feedback is None:
        return []
    grid, twins = plan.grid_kg.tolist(), LinearTwins(plant, plan.dof, plan.period_s)
    loops = [
        open_loops(filters, tip_responses(twins, payload_kg), plan.period_s)
        for filters, payload_kg in zip(plan.feedback.filters, grid, strict=True)
    ]
    rates_rad_s = frequencies(plan.period_s)
    colours = ordered_colours(len(grid))
    legend = [LegendEntry(c, f"{m:g} kg") for c, m in zip(colours, grid, strict=True)]
    figures = []
    for joint in range(1, plan.dof + 1):
        sliding = [of_payload[joint - 1][0] for of_payload in loops]
        name = f"{plan.dof}DOF, joint {joint}"
        panels = [draw(rates_rad_s, sliding, colours, name) for draw in (_gain, _phase, _nyquist)]
        note = "Nyquist: the red cross is −1; the marks are 6 dB and 45° beside it."
        figures.append(Figure(f"Loop of {name}", note, panels, legend=legend))
    return figures


def _gain(
    rates_rad_s: Array, loops: Sequence[Response], colours: Sequence[str], name: str
) -> Panel:
    with Drawing() as (drawing, ax):
        for loop, colour in zip(loops, colours, strict=True):
            ax.loglog(rates_rad_s, np.abs(loop), color=colour, lw=1.0)
        ax.axhline(1.0, color=MUTED, lw=0.8)
        ax.set(xlabel="frequency, rad/s", ylabel="gain")
    return drawing.panel("Bode, gain", f"Gain of the loop of {name} over frequency, by payload.")


def _phase(
    rates_rad_s: Array, loops: Sequence[Response], colours: Sequence[str], name: str
) -> Panel:
    with Drawing() as (drawing, ax):
        for loop, colour in zip(loops, colours, strict=True):
            phase = ANGLE.shown(np.unwrap(np.angle(loop)))
            ax.semilogx(rates_rad_s, phase, color=colour, lw=1.0)
        ax.axhline(-180.0, color=MUTED, lw=0.8)
        ax.set(xlabel="frequency, rad/s", ylabel=ANGLE.label("phase"))
    return drawing.panel("Bode, phase", f"Phase of the loop of {name} over frequency, by payload.")


def _nyquist(
    rates_rad_s: Array, loops: Sequence[Response], colours: Sequence[str], name: str
) -> Panel:
    half = NYQUIST_HALF_WIDTH
    with Drawing(3.6) as (drawing, ax):
        for loop, colour in zip(loops, colours, strict=True):
            ax.plot(loop.real, loop.imag, color=colour, lw=1.0)
        _marks(ax)
        ax.set(xlim=(-half, half), ylim=(-half, half), xlabel="real part", ylabel="imaginary part")
        ax.set_aspect("equal")
    return drawing.panel("Nyquist", f"Nyquist diagram of the loop of {name}, by payload.")


def _marks(ax: Any) -> None:
    """Draw the unit circle, −1, and the smallest allowed margins."""
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    ax.plot(np.cos(turn), np.sin(turn), color=MUTED, lw=0.6)
    ax.plot([-1.0], [0.0], "+", color=ALARM, ms=9)
    ax.plot([-(10.0 ** (-LEAST_GAIN_DB / 20.0))], [0.0], "|", color=INK, ms=9)
    side = np.sin(LEAST_PHASE_RAD)
    ax.plot([-np.cos(LEAST_PHASE_RAD)] * 2, [side, -side], "x", color=INK, ms=6)
