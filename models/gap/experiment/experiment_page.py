"""Page of a designed motion: its goals, and the separation of every pair."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from firmware_py.motion import Motion
from models.gap.experiment.experiment import Experiment, better_fixed_in_words
from models.gap.experiment.rival import Rival
from models.shared.drawing import Drawing
from models.shared.pages import (
    Cell,
    Figure,
    LegendEntry,
    Paragraph,
    Part,
    Section,
    Table,
    render_page,
)
from models.shared.palette import AFTER, BEFORE, MUTED


def write_experiment_page(found: Experiment, path: Path) -> Path:
    document, fixed = found.design.document, found.better_fixed
    advice = (
        f"Run {better_fixed_in_words(fixed)}. Diagnose its trial together with those at hand."
        if fixed
        else "Of all motions tried it tells the hypotheses of the diagnosis apart best. Attach "
        f"{document.payload_kg:g} kg, run it, and diagnose its trial together with those at hand."
    )
    lead: list[Part] = [Paragraph(f"A motion of {document.duration_s:g} s was designed. {advice}")]
    sections = [
        Section("motion", "The motion", [_goals(found)]),
        Section("separation", "What it separates", [_bars(found), _table(found)]),
    ]
    path.write_text(render_page("The next experiment", lead, sections), encoding="utf-8")
    return path


def _words(rival: Rival) -> str:
    return rival.label.replace("_", " ")


def _goals(found: Experiment) -> Figure:
    document, limits = found.design.document, found.limits
    time_s = np.linspace(-1.0, document.duration_s + 1.0, 600)
    goal_rad = Motion.designed(document).goal_rad(time_s)
    with Drawing() as (drawing, ax):
        for j in range(goal_rad.shape[1]):
            ax.plot(time_s, goal_rad[:, j], label=f"joint {j + 1}")
        for limit in limits.angle_rad:
            ax.axhline(limit, color=MUTED, dashes=(3, 2), linewidth=0.9)
        ax.set_xlabel("time in s")
        ax.set_ylabel("goal in rad")
        if goal_rad.shape[1] > 1:
            ax.legend(frameon=False)
    title = f"Goals, {document.name}"
    return Figure(
        "", "Goals of the motion; dashed: the limits of the angle.",
        [drawing.panel(title, f"Goals between {goal_rad.min():.2f} and {goal_rad.max():.2f} rad.")],
    )  # fmt: skip


def _bars(found: Experiment) -> Figure:
    pairs, best = found.design.pairs, found.best_fixed
    place = np.arange(len(pairs), dtype=np.float64)
    rows = [(MUTED, [q.before for q in pairs])]
    if best is not None:
        rows.append((BEFORE, [q.separation for q in best.pairs]))
    rows.append((AFTER, [q.separation for q in pairs]))
    high = 0.8 / len(rows)
    with Drawing(0.9 + 0.45 * len(pairs)) as (drawing, ax):
        for k, (colour, values) in enumerate(rows):
            ax.barh(place + (k - (len(rows) - 1) / 2) * high, values, 0.9 * high, color=colour)
        ax.axvline(found.least_separation, color=MUTED, dashes=(3, 2), linewidth=0.9)
        ax.set_yticks(place, [found.label(k).replace("_", " ") for k in range(len(pairs))])
        ax.invert_yaxis()
        ax.set_xlabel("d′")
        ax.grid(visible=False, axis="y")
    legend = [LegendEntry(MUTED, "trials at hand")]
    if best is not None:
        legend.append(LegendEntry(BEFORE, f"with {best.label}, {best.payload_kg:g} kg"))
    legend.append(LegendEntry(AFTER, "with the designed motion"))
    listed = ", ".join(f"{found.label(k)} {q.separation:.1f}" for k, q in enumerate(pairs))
    return Figure(
        "", "d′ of each pair of hypotheses after nuisance and the other hypothesis were refitted; "
        "pairs below the dashed line stay together.",
        [drawing.panel("Separation", f"d′ with the designed motion: {listed}.")], legend=legend,
    )  # fmt: skip


def _table(found: Experiment) -> Table:
    best = found.best_fixed
    rows: list[list[Cell]] = []
    for k, own in enumerate(found.design.pairs):
        a, b = (found.rivals[i] for i in found.pairs[k])
        fixed = f"{best.pairs[k].separation:.1f}" if best else ""
        rows.append(
            [_words(a), f"{a.probability:.2f}", _words(b), f"{b.probability:.2f}",
             f"{own.before:.1f}", fixed, f"{own.separation:.1f}"]
        )  # fmt: skip
    head = ["hypothesis", "probability", "or", "probability", "d′ now", "fixed motion", "designed"]
    note = "; ".join(f"it does not separate {pair}" for pair in found.together())
    return Table("", head, rows, note)
