"""Page of a diagnosis (`OUT/report.html`): where the gap is, what is missing, before and after.

It is drawn from gap.json, the two plants and the trials alone, so it can be drawn again from these
files. `hil.report.gap.before_after_page` adds sections about FMU and robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from firmware_py.display_units import FRACTION, LENGTH, error_unit, signal_words
from models.gap.report.effect_checks import effects_to_check
from models.gap.report.gap_charts import (
    BEFORE_AND_AFTER,
    draw_traces,
    draw_waterfall,
)
from models.gap.report.gap_json import GapDocument, SignalGap
from models.gap.report.gap_words import (
    floor_in_words,
    probabilities_in_words,
    refusals_in_words,
    verdict_in_words,
)
from models.gap.report.localisation_maps import localisation_maps
from models.gap.report.missing_effects import compared_effects, named_effects
from models.gap.report.next_step import is_plant_as_given, next_step_in_words
from models.gap.report.trial_notes import notes_in_words
from models.gap.residuals.localisation import signal_in_words
from models.plant.identification.evaluation import TIP, Comparison, compare_with_trials
from models.plant.identification.noise_floor import Array
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
    render_page,
)
from models.shared.palette import MUTED
from models.trials.origin import origin_notice, origins_of
from models.trials.trial import TrialSet


def write_gap_page(
    document: GapDocument, before: Plant, after: Plant, trials: TrialSet, path: Path
) -> Path:
    page = render_page(
        "The gap between plant and measurement",
        [
            origin_notice(origins_of(trials)),
            *gap_lead(document, str(path.with_name("gap.json"))),
        ],
        gap_sections(document, before, after, trials),
    )
    path.write_text(page, encoding="utf-8")
    return path


def gap_lead(document: GapDocument, gap_json: str = "OUT/gap.json") -> list[Part]:
    """Verdict, location of the gap, the plant's tip error before and after, and the next step."""
    said = document.sentence
    for more in notes_in_words(document):
        said += f" {more[0].upper() + more[1:]}."
    tip_m = [_tip_m(getattr(document, when)) for when in ("before", "after")]
    if (document.refitted or any(row.kept for row in document.named)) and tip_m[0]:
        before, after = (LENGTH.significant(value) for value in tip_m)
        said += f" The tip error of the plant is {before} RMS before and {after} RMS after."
    known = probabilities_in_words(document)
    next_step = Markup("{} <b>Next:</b> {}").format(known, next_step_in_words(document, gap_json))
    return [
        Paragraph(Markup("<b>{}</b> {}").format(verdict_in_words(document), said), "lead"),
        Paragraph(next_step),
    ]


def gap_sections(
    document: GapDocument,
    before: Plant,
    after: Plant,
    trials: TrialSet,
    hidden: Mapping[str, float] | None = None,
) -> list[Section]:
    """Sections of the page of a diagnosis; the last one lists the effects that were not named.

    `hidden` holds effects that were hidden on a rig and their strengths; it adds a column to the
    table.
    """
    result = [
        Section("where", "Where the gap is", [localisation_maps(
            document.map, trials[0], document.settings.false_discovery_rate
        )]),
        Section(
            "what", "What is missing",
            [
                *named_effects(document, hidden), *_checks(document), *compared_effects(document),
                Paragraph(
                    "d′ is the distance from a plant without the effect, in standard deviations "
                    f"of the {floor_in_words(document)}. The d′ that an effect needs was "
                    "measured on trials without a gap; the bars show the ratio of its d′ to "
                    "that. A strength that differs much between payloads, signals and "
                    "frequencies points to another effect.",
                    "note",
                ),
            ],
        ),
    ]  # fmt: skip
    if document.refused:
        result.append(Section("refused", "What was refused", _refused(document)))
    if document.waterfall:
        result.append(Section("waterfall", "What each step removes", [_waterfall(document)]))
    result.append(_compared(document, before, after, trials))
    result.append(Section("others", "Effects not named", [_rejected(document)]))
    return result


def _checks(document: GapDocument) -> list[Part]:
    """Table of what to check on the robot; empty where nothing may be missing."""
    rows: list[list[Cell]] = [[_words(e), check] for e, check in effects_to_check(document).items()]
    return [Table("What to check on the robot", ["effect", "check"], rows)] if rows else []


def _refused(document: GapDocument) -> list[Part]:
    """Sentences on what was refused, and the held-out errors of the plant that was written."""
    written = (
        "The plant that was written is the plant as given, unchanged."
        if is_plant_as_given(document)
        else "The plant that was written is the best one without what was refused."
    )
    parts: list[Part] = [Paragraph(text) for text in refusals_in_words(document)]
    parts.append(Paragraph(written))
    if document.held_out is None:
        return parts
    units = {s: row.unit for s, row in document.before["fitted"].items()}
    rows: list[list[Cell]] = []
    for signal, row in document.held_out.signals.items():
        unit = error_unit(units.get(signal, "1"))
        ratio = FRACTION.text(row.improved / row.given) if row.given else ""
        rows.append(
            [signal_in_words(signal), unit.significant(row.given), unit.significant(row.improved),
             ratio]
        )  # fmt: skip
    caption = f"Left out in turn: {', '.join(document.held_out.left_out)}."
    head = ["held-out RMS error", "plant as given", "plant as written", "ratio"]
    parts.append(Table("", head, rows, caption))
    return parts


def _waterfall(document: GapDocument) -> Figure:
    steps = [(step.step, step.floors) for step in document.waterfall]
    with Drawing(0.9 + 0.3 * len(steps)) as (drawing, ax):
        draw_waterfall(ax, steps, 1.0, "RMS in noise floors")
    listed = ", ".join(f"{label} {value:.2f}" for label, value in steps)
    return Figure(
        "", "Root mean square of all signals on repetitions that no value was fitted to: the plant "
        "as given, its nominal parameters refitted, and each effect in turn; what varies between "
        "trials is fitted. Pale: what the step "
        f"removed. Dashed: the {floor_in_words(document)}.",
        [drawing.panel("Residual after each step", f"RMS in noise floors: {listed}.")],
    )  # fmt: skip


def _tip_m(errors: Mapping[str, Mapping[str, SignalGap]]) -> float:
    """Root mean square distance of the tip on the held-out trials, m; zero where there
    is no tip.
    """
    rows = errors.get("held_out", errors["fitted"])
    return float(np.sqrt(sum(rows[axis].rms ** 2 for axis in TIP if axis in rows)))


def _words(name: str) -> str:
    return name.replace("_", " ")


def _rejected(document: GapDocument) -> Table:
    by_reason: dict[str, list[str]] = {}
    for row in document.rejected:
        said = f"{_words(row.effect)} ({row.separation:.1f})"
        by_reason.setdefault(row.reason, []).append(said)
    rows = [[why, ", ".join(names)] for why, names in by_reason.items()]
    return Table("", ["reason", "effects, with their d′"], rows)


def _compared(document: GapDocument, before: Plant, after: Plant, trials: TrialSet) -> Section:
    """Error of both plants, by signal and on the heaviest of the held-out trials."""
    part = "held_out" if "held_out" in document.before else "fitted"
    rows = []
    for signal, row in document.before[part].items():
        unit = error_unit(row.unit)
        rows.append(
            [
                signal_in_words(signal), unit.significant(row.rms),
                unit.significant(document.after[part][signal].rms),
                unit.significant(row.rms / row.floors) if row.floors else "",
            ]
        )  # fmt: skip
    trial = max(trials.split()[1] or trials, key=lambda t: t.meta.payload_kg)
    both = [compare_with_trials(plant, [trial])[0] for plant in (before, after)]
    return Section(
        "residual", "Before and after",
        [
            Table("", ["RMS error", "before", "after", floor_in_words(document)], rows,
                  "Over the repetitions with every payload. What varies between trials counts "
                  "here; the floor leaves it out."),
            Figure(
                "", f"Measured minus simulated in trial {trial.name}.",
                _residuals(document, part, both),
                legend=[*BEFORE_AND_AFTER, LegendEntry(MUTED, floor_in_words(document))],
            ),
        ],
    )  # fmt: skip


def _residuals(document: GapDocument, part: str, both: Sequence[Comparison]) -> list[Panel]:
    panels = []
    for signal in both[0].simulated:
        series = [-c.error(signal) for c in both]
        still = all(np.ptp(c.simulated[signal]) == 0 for c in both)  # across a single joint's plane
        if still or not np.any(np.abs(series[0]) > 0) or signal not in document.before[part]:
            continue
        row = document.before[part][signal]
        floor = row.rms / row.floors if row.floors else None
        panels.append(
            residual_panel(signal_words(signal), both[0].trial.time_s, series, row.unit, floor)
        )
    return panels


def residual_panel(
    signal: str, time_s: Array, series: Sequence[Array], unit: str, floor: float | None
) -> Panel:
    """Panel of the error of a signal over time, before and after.

    Shapes: `time_s` (n,), each of `series` (n,).
    """
    shown = error_unit(unit)
    with Drawing(2.1) as (drawing, ax):
        draw_traces(ax, time_s, series, shown, "error", floor)
    sizes = [float(np.sqrt(np.nanmean(values**2))) for values in series]
    before, after = (shown.significant(size) for size in sizes)
    return drawing.panel(
        f"{signal}: {before} → {after} RMS",
        f"Error of {signal} over {time_s[-1] - time_s[0]:.1f} s: {before} RMS before, {after} RMS "
        "after.",
    )
