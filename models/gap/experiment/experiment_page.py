"""Page of an experiment: goals of the best motion, separation of every pair, and the ranking."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.core.units import ANGLE, TIME
from models.gap.experiment.experiment import SEPARATED, Experiment
from models.shared.drawing import Drawing
from models.shared.pages import (
    Cell,
    Figure,
    Folded,
    LegendEntry,
    Paragraph,
    Part,
    Section,
    Table,
    render_page,
)
from models.shared.palette import AFTER, BEFORE, MUTED

FIRST_MOTIONS: Final = 8
"""Motions at the head of the ranking; the others are folded."""


def write_experiment_page(experiment: Experiment, path: Path) -> Path:
    best = experiment.best
    lead = Paragraph(
        f"Of {len(experiment.ranked)} motions and payloads within the limits this one separates "
        f"the hypotheses of the diagnosis best: {best.label}. Attach {best.payload_kg:g} kg, run "
        "it, and diagnose its trial together with those at hand."
    )
    sections = [
        Section("motion", "The motion", [_goals(experiment)]),
        Section("separation", "What it separates", [_bars(experiment)]),
        Section("ranking", "All motions", _ranking(experiment)),
    ]
    path.write_text(render_page("The next experiment", [lead], sections), encoding="utf-8")
    return path


def _goals(experiment: Experiment) -> Figure:
    motion = experiment.best.motion
    time_s = np.linspace(-1.0, motion.duration_s + 1.0, 600)
    goal_rad = motion.goal_rad(time_s)
    with Drawing() as (drawing, ax):
        for j, row in enumerate(goal_rad.T, 1):
            ax.plot(time_s, ANGLE.shown(row), label=f"joint {j}")
        for limit_rad in experiment.limits.angle_rad:
            ax.axhline(ANGLE.factor * limit_rad, color=MUTED, dashes=(3, 2), linewidth=0.9)
        ax.set(xlabel=TIME.label("time"), ylabel=ANGLE.label("goal"))
        if motion.dof > 1:
            ax.legend(frameon=False)
    alt = f"Goals between {ANGLE.text(goal_rad.min())} and {ANGLE.text(goal_rad.max())}."
    note = "Goals of the motion; dashed: the limits of the angle."
    return Figure("", note, [drawing.panel(f"Goals, {experiment.best.label}", alt)])


def _bars(experiment: Experiment) -> Figure:
    labels = [label.replace("_", " ") for label in experiment.pairs]
    series = [(MUTED, "trials at hand", experiment.before)]
    series += [
        (colour, f"with {r.label}, {r.payload_kg:g} kg", r.separations)
        for colour, r in zip((AFTER, BEFORE), experiment.ranked, strict=False)
    ]
    place, high = np.arange(len(labels), dtype=np.float64), 0.8 / len(series)
    with Drawing(0.9 + 0.5 * len(labels)) as (drawing, ax):
        for k, (colour, _, values) in enumerate(series):
            ax.barh(place + (k - (len(series) - 1) / 2) * high, values, 0.9 * high, color=colour)
        ax.axvline(SEPARATED, color=MUTED, dashes=(3, 2), linewidth=0.9)
        ax.set_yticks(place, [label.replace(" or ", "\nor ") for label in labels])
        ax.invert_yaxis()
        ax.set_xlabel("d′")
        ax.grid(visible=False, axis="y")
    listed = zip(labels, experiment.best.separations, strict=True)
    alt = "d′ with the best motion: " + ", ".join(f"{name} {d:.1f}" for name, d in listed) + "."
    return Figure(
        "", "d′ of each pair of hypotheses after nuisance and the other hypothesis were refitted; "
        "pairs below the dashed line stay together.",
        [drawing.panel("Separation", alt)],
        legend=[LegendEntry(colour, text) for colour, text, _ in series],
    )  # fmt: skip


def _ranking(experiment: Experiment) -> list[Part]:
    rows: list[list[Cell]] = [
        [
            ranked.label,
            f"{ranked.payload_kg:g} kg",
            f"{ranked.least_gain:.1f}",
            *(
                f"{a:.1f} → {b:.1f}"
                for a, b in zip(experiment.before, ranked.separations, strict=True)
            ),
        ]
        for ranked in experiment.ranked
    ]
    pairs = [label.replace("_", " ") for label in experiment.pairs]
    note = "d′ of each pair with the trials at hand → with the motion added."
    head = ["motion", "payload", "least gain", *pairs]
    best, others = rows[:FIRST_MOTIONS], rows[FIRST_MOTIONS:]
    parts: list[Part] = [Table("", head, best, note)]
    if others:
        parts.append(Folded(f"{len(others)} further motions", [Table("", head, others)]))
    return parts
