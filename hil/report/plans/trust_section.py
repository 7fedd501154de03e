"""Section on trust in the estimated tip in the page of plans, with runs in which it was lost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from firmware_py.core.units import ANGLE, LENGTH, TIME
from firmware_py.goals.plan_goals import PlanGoals
from firmware_py.safety.estimate_trust import FADE_S, TrustState
from hil.report.plans.planned_runs import PlannedRun
from models.shared.drawing import Drawing
from models.shared.pages import Figure, LegendEntry, Panel, Paragraph, Part, Section, Table
from models.shared.palette import PURPLE, SERIES, SPAN


def trust_section(runs: Sequence[PlannedRun]) -> Section | None:
    """Return the section; None if no run has feedback."""
    guided = [r for r in runs if (r.trust != TrustState.NONE).any()]
    if not guided:
        return None
    rows = [
        [f"{r.dof}DOF, {_words(r)}", _seconds(r, TrustState.FADING), _seconds(r, TrustState.LOST)]
        for r in guided
    ]
    parts: list[Part] = [
        Paragraph(
            "Two bad ticks in a row end the trust in the estimated tip: an innovation of a "
            "current that is too large, a tip out of range or not finite, stale data. The "
            f"corrections fade out within {FADE_S:g} s, and the plan goes on without them; or the "
            "robot stops, where robot.toml says so. They come back once the estimate was good for "
            "a second. The fault campaign tries every way out of trust (docs/safety.md)."
        ),
        Table("Time without trust, in s", ["", "fading", "lost"], rows),
    ]
    panels = [p for r in guided if r.knowledge == "misled" for p in (_error(r), _correction(r))]
    if panels:
        joints = max(r.dof for r in guided if r.knowledge == "misled")
        legend = [LegendEntry(SPAN, "not trusted")]
        legend += [LegendEntry(SERIES[j], f"correction of joint {j + 1}") for j in range(joints)]
        parts.append(Figure("A robot that was told too small a payload", "", panels, legend=legend))
    return Section("trust", "When the estimate is not trusted", parts)


def _words(run: PlannedRun) -> str:
    if run.knowledge != "misled":
        return f"{run.payload_kg:g} kg, payload {run.knowledge}"
    return f"told {run.payload_kg:g} kg, {run.payload_kg + run.unknown_kg:g} kg at the tip"


def _seconds(run: PlannedRun, state: TrustState) -> str:
    return f"{run.plan.period_s * np.count_nonzero(run.trust == state):.1f}"


def _error(run: PlannedRun) -> Panel:
    time_s = run.plan.period_s * np.arange(run.plan.rows)
    with Drawing() as (drawing, ax):
        _shade(ax, run)
        ax.plot(time_s, LENGTH.shown(run.away_m), color=PURPLE, lw=1.0)
        ax.set(xlabel=TIME.label("time"), ylabel=LENGTH.label("distance from the path"))
    name = f"{run.dof}DOF, {_words(run)}"
    return drawing.panel(name, f"Distance from the path, {LENGTH.text(run.max_m)} at most.")


def _correction(run: PlannedRun) -> Panel:
    """Draw the corrections: goals sent minus goals of the plan."""
    plan = run.plan
    planned = PlanGoals(plan, run.payload_kg)
    beyond = run.goals_rad - np.array([planned.at(row) for row in range(plan.rows)])
    time_s = plan.period_s * np.arange(plan.rows)
    with Drawing() as (drawing, ax):
        _shade(ax, run)
        for column, colour in zip(beyond.T, SERIES, strict=False):
            ax.plot(time_s, ANGLE.shown(column), color=colour, lw=1.0)
        ax.set(xlabel=TIME.label("time"), ylabel=ANGLE.label("correction"))
    largest = ANGLE.text(float(np.abs(beyond).max()))
    return drawing.panel(
        "corrections of the joints", f"Corrections of the goals, {largest} at most."
    )


def _shade(ax: Any, run: PlannedRun) -> None:
    """Shade the times in which the estimate was not trusted."""
    doubted = np.concatenate([[False], run.trust > TrustState.TRUSTED, [False]])
    edges = np.flatnonzero(np.diff(doubted.astype(int)))
    for first, after in edges.reshape(-1, 2):
        ax.axvspan(first * run.plan.period_s, after * run.plan.period_s, color=SPAN, lw=0)
