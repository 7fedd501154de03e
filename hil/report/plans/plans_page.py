"""Page of plans on the rig: paths, errors, payloads, margins of the feedback, lost trust."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.core.units import LENGTH, POSITION, TIME
from firmware_py.system.targets import PATH_RMS_TO_RIGID
from hil.report.plans.feedback_section import feedback_section
from hil.report.plans.planned_runs import KNOWLEDGE, Knowledge, PlannedRun, plan_figures
from hil.report.plans.trust_section import trust_section
from hil.report.report_origins import EMULATED
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
    render_page,
)
from models.shared.palette import BLUE, GREEN, INK, ORANGE, PURPLE

COLOURS: Final[dict[Knowledge, str]] = {
    "rigid": ORANGE, "known": BLUE, "unknown": GREEN, "misled": PURPLE,
}  # fmt: skip
WORDS: Final[dict[Knowledge, str]] = {
    "rigid": "rigid kinematics",
    "known": "plan, payload known",
    "unknown": "plan, payload estimated, second run",
    "misled": "plan, payload told too small",
}
TOLD: Final = {"known": "known", "unknown": "estimated"}


def write_plans_page(runs: Sequence[PlannedRun], path: Path, plant: Plant | None = None) -> None:
    """Write the page; diagrams of the feedback need the plant with which the plans were made."""
    lead: list[Part] = [
        EMULATED,
        Paragraph(
            "The robot's own loop ran each plan against emulated servos, with the rig behind them. "
            "The rig is no twin: its equations differ from those of the plant that was inverted, "
            "and its variation is drawn with a seed that planning never saw.", "lead",
        ),
        _table(list(runs)),
    ]  # fmt: skip
    compared = [r for r in runs if r.knowledge in KNOWLEDGE]
    numbers = sorted({r.dof for r in compared})
    sections = [_section(dof, [r for r in compared if r.dof == dof]) for dof in numbers]
    plans = {r.dof: r.plan for r in compared if r.knowledge != "rigid"}
    more = (trust_section(runs), feedback_section(plans, plant))
    page = render_page("The tip on its path", lead, [*sections, *filter(None, more)])
    path.write_text(page, encoding="utf-8")


def _table(runs: list[PlannedRun]) -> Table:
    rows: list[list[Cell]] = []
    for case in plan_figures(runs)["cases"]:
        row: list[Cell] = [f"{case['dof']}DOF, {case['payload_kg']:g} kg"]
        row += [_length(case, k) for k in KNOWLEDGE]
        row += [_ratio(case, k) for k in PATH_RMS_TO_RIGID]
        rows.append(row)
    return Table(
        "Distance of the tip from its path, RMS in mm, rest and ways included",
        ["", *(WORDS[k] for k in KNOWLEDGE), *(f"rigid over {TOLD[k]}" for k in PATH_RMS_TO_RIGID)],
        rows,
        "Targets: rigid kinematics over the plan at least "
        + ", ".join(f"{1 / v:.0f} ({TOLD[k]})" for k, v in PATH_RMS_TO_RIGID.items()) + ".",
    )  # fmt: skip


def _length(case: dict[str, Any], knowledge: str) -> str:
    value = case.get(f"{knowledge}_rms_m")
    return "–" if value is None else LENGTH.number(value, 2)


def _ratio(case: dict[str, Any], knowledge: str) -> TableCell:
    value = case.get(f"{knowledge}_ratio")
    if value is None:
        return TableCell("–")
    return TableCell(f"{1 / value:.1f}", bool(value <= PATH_RMS_TO_RIGID[knowledge]))


def _section(dof: int, runs: Sequence[PlannedRun]) -> Section:
    payloads = sorted({r.payload_kg for r in runs})
    groups = {m: [r for r in runs if r.payload_kg == m] for m in payloads}
    shown = [k for k in KNOWLEDGE if any(r.knowledge == k for r in runs)]
    legend = [LegendEntry(INK, "desired", "dashed")]
    legend += [LegendEntry(COLOURS[k], WORDS[k]) for k in shown]
    paths = [_path(dof, m, own) for m, own in groups.items()]
    errors = [_error(dof, m, own) for m, own in groups.items()]
    return Section(
        f"dof{dof}", f"{dof}DOF: {runs[0].plan.path}",
        [
            Figure("Path", "Payloads side by side.", paths, legend=legend),
            Figure("Distance from the path over time", "", errors, legend=legend[1:]),
        ],
    )  # fmt: skip


def _path(dof: int, payload_kg: float, runs: Sequence[PlannedRun]) -> Panel:
    plan, inside = runs[0].plan, slice(runs[0].plan.start_row, runs[0].plan.end_row)
    time_s, desired = plan.period_s * np.arange(plan.rows), plan.desired_tip_m()
    with Drawing(3.6 if dof == 2 else 2.9) as (drawing, ax):
        for k, run in enumerate(runs):  # each thinner than the one below, because they coincide
            xy = run.tip_m[inside].T if dof == 2 else (time_s, run.tip_m[:, 0])
            ax.plot(*xy, color=COLOURS[run.knowledge], lw=1.2 + 1.1 * (len(runs) - 1 - k))
        wanted = desired[inside].T if dof == 2 else (time_s, desired[:, 0])
        ax.plot(*wanted, color=INK, lw=0.9, dashes=(4, 3))
        if dof == 2:
            ax.set_aspect("equal")
            ax.set(xlabel=POSITION.label("tip x"), ylabel=POSITION.label("tip y"))
        else:
            ax.set(xlabel=TIME.label("time"), ylabel=POSITION.label("tip x"))
    words = ", ".join(f"{WORDS[r.knowledge]} {LENGTH.text(r.rms_m, 2)} RMS" for r in runs)
    return drawing.panel(f"{payload_kg:g} kg", f"Tip of the rig with {payload_kg:g} kg: {words}.")


def _error(dof: int, payload_kg: float, runs: Sequence[PlannedRun]) -> Panel:
    with Drawing() as (drawing, ax):
        for run in runs:
            time_s = run.plan.period_s * np.arange(run.plan.rows)
            away = LENGTH.shown(np.maximum(run.away_m, 1e-4))
            ax.plot(time_s, away, color=COLOURS[run.knowledge], lw=1.0)
        ax.set(yscale="log", xlabel=TIME.label("time"), ylabel=LENGTH.label("distance"))
    words = ", ".join(f"{WORDS[r.knowledge]} {LENGTH.text(r.max_m)}" for r in runs)
    return drawing.panel(f"{dof}DOF, {payload_kg:g} kg", f"Largest distance: {words}.")
