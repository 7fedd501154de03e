"""Page of a diagnosis (`OUT/report.html`): what is missing, and measured against simulated.

It is drawn from gap.json, the two plants and the trials alone, so it can be drawn again from these
files. `hil.report.gap_page` adds sections about FMU and robot.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from markupsafe import Markup

from firmware_py.core.documents import write_document
from firmware_py.core.signals import without_unit
from firmware_py.core.units import FRACTION, error_unit, signal_unit, signal_words
from models.gap.report.gap_charts import (
    BEFORE_AND_AFTER,
    SignalCurves,
    draw_signal,
    signal_curves,
)
from models.gap.report.gap_json import DiagnosisInputs, GapDocument, NamedEffect
from models.gap.report.gap_results import Diagnosis
from models.gap.report.gap_words import (
    amount,
    effect_in_words,
    effects_to_check,
    errors_in_order,
    errors_of_what,
    in_percent,
    look_alikes_in_words,
    next_step_in_words,
    notes_in_words,
    refused_in_words,
)
from models.gap.residuals.localisation import FALSE_DISCOVERY_RATE, GapRegion, signal_in_words
from models.plant.plant import Plant
from models.shared.catalogue import EVERY_EFFECT
from models.shared.drawing import Drawing
from models.shared.pages import (
    NO_VALUE,
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
from models.shared.palette import MEASURED, MUTED
from models.trials.origin import origin_notice, origins_of
from models.trials.trial import Trial

MOST_HYPOTHESES: Final = 6
FACTORS: Final = {
    "phase": "Phase of the cycle", "stroke": "Stroke", "payload": "Payload",
    "band": "Frequency in Hz", "angle": "Angle", "direction": "Direction",
}  # fmt: skip
LEVELS: Final = {
    "way out to positive angles": "out to +", "return from positive angles": "back from +",
    "way out to negative angles": "out to −", "return from negative angles": "back from −",
    "towards +": "to +", "towards −": "to −", "standing": "standing",
    "negative": "negative", "middle": "middle", "positive": "positive",
}  # fmt: skip
"""Levels of a factor without a number, in the order of their columns, with their heads."""


def write_results(
    diagnosis: Diagnosis, inputs: DiagnosisInputs, out: Path
) -> tuple[GapDocument, Path]:
    """Write OUT/gap.json, OUT/plant.json and OUT/report.html.

    Returns the document and the path of the page.
    """
    document = msgspec.structs.replace(diagnosis.document, inputs=inputs)
    out.mkdir(parents=True, exist_ok=True)
    write_document(out / "gap.json", document)
    diagnosis.improved.write(out / "plant.json")
    page = render_page(
        "The gap between plant and measurement",
        [
            origin_notice(origins_of(diagnosis.trials)),
            *gap_lead(
                document, diagnosis.plant, diagnosis.improved, diagnosis.trials,
                str(out / "gap.json"),
            ),
        ],
        gap_sections(document),
    )  # fmt: skip
    path = out / "report.html"
    path.write_text(page, encoding="utf-8")
    return document, path


def gap_lead(
    document: GapDocument,
    before: Plant,
    after: Plant,
    trials: Sequence[Trial],
    gap_json: str = "OUT/gap.json",
) -> list[Part]:
    """What is wrong and how sure that is, what to do, how much better the plant is, and where."""
    next_step = Markup("<b>Next:</b> {}").format(next_step_in_words(document, gap_json))
    return [
        Paragraph(document.headline, "lead"),
        *_checks(document),
        Paragraph(next_step),
        _signals(document, signal_curves(document, before, after, trials)),
        _errors(document),
    ]


def _signals(document: GapDocument, curves: Sequence[SignalCurves]) -> Figure:
    legend = [LegendEntry(MEASURED, "measured"), *BEFORE_AND_AFTER[: len(curves[0].simulated)]]
    legend += [LegendEntry(MUTED, "noise floor")] if document.floor_rms else []
    return Figure(
        "Measured and simulated",
        f"Trial {curves[0].trial}, in which the error of the first signal falls most; below "
        "each signal its error, measured minus simulated.",
        [_signal(row) for row in curves],
        legend=legend,
    )  # fmt: skip


def _signal(curves: SignalCurves) -> Panel:
    unit, name = error_unit(curves.unit), signal_words(curves.signal)
    with Drawing(3.4) as (drawing, ax):
        upper, lower = ax.figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        ax.remove()
        draw_signal(upper, lower, curves, signal_unit(curves.signal), error_unit(curves.unit))
    errors = " → ".join(unit.significant(np.sqrt(np.nanmean(e**2))) for e in curves.errors)
    return drawing.panel(
        f"{name}: error {errors}",
        f"{name} over {curves.time_s[-1]:.1f} s, measured and simulated; RMS error {errors}.",
    )


def _errors(document: GapDocument) -> Table:
    floor = document.floor_rms
    rows: list[list[Cell]] = []
    for signal, before, after in errors_in_order(document):
        unit, name = error_unit(before.unit), signal_in_words(signal)
        row: list[Cell] = [
            unit.label(_capitalised(name)),
            f"{unit.factor * before.rms:.3g}",
            f"{unit.factor * after.rms:.3g}",
            _change(after.rms / before.rms - 1) if before.rms else NO_VALUE,
        ]
        if floor:
            row.append(f"{unit.factor * floor[signal]:.3g}" if signal in floor else NO_VALUE)
        rows.append(row)
    head = ["", "before", "after", "change", *(["noise floor"] if floor else [])]
    title = errors_of_what(document)
    note = (
        "RMS error of the plant before, and of one fitted to the rest in the same way as the plant "
        "that was written."
        + (" What varies between trials counts; the floor leaves it out." if floor else "")
    )
    return Table(_capitalised(title), head, rows, note)


def _change(fraction: float) -> str:
    return f"{fraction:+.0%}".replace("-", "−") if abs(fraction) >= 0.005 else "none"


def _checks(document: GapDocument) -> list[Part]:
    rows: list[list[Cell]] = [
        [effect_in_words(e), check] for e, check in effects_to_check(document).items()
    ]
    return [Table("What to check on the robot", ["effect", "check"], rows)] if rows else []


def gap_sections(document: GapDocument) -> list[Section]:
    """Sections of the page below its lead; the last one lists the effects that were not named."""
    where = localisation_maps(document.map, document.noise_floor.learned)
    result = [
        Section("what", "What is missing, and what else could explain it", _what(document)),
        Section("where", "Where the gap is", [Paragraph(document.sentence), *where]),
        Section("written", "What was written to the plant", _written(document)),
    ]
    if notes := notes_in_words(document):
        result.append(Section("notes", "About the trials", [Paragraph(note) for note in notes]))
    result.append(Section("others", "Effects not named", [_rejected(document)]))
    return result


def _what(document: GapDocument) -> list[Part]:
    parts: list[Part] = []
    if document.named:
        head = ["named", "value", "d′"]
        parts.append(Table("", head, [_named_row(row) for row in document.named]))
    texts = [look_alikes_in_words(row) for row in document.named] + refused_in_words(document)
    parts += [Paragraph(text) for text in texts if text]
    if document.probabilities is not None:
        parts.append(_hypotheses(document, document.probabilities.outside))
    floor = "noise floor" if document.floor_rms else "residual of the refitted plant"
    note = "d′ is the distance from a plant without the effect, in standard deviations of the "
    parts.append(Paragraph(f"{note}{floor}.", "note"))
    return parts


def _named_row(row: NamedEffect) -> list[Cell]:
    known = EVERY_EFFECT.get(row.effect)
    values = Markup("<br>").join(
        f"{without_unit(name)}: {amount(q)}" + ("" if q.error is not None else " (not fitted)")
        for name, q in row.parameters.items()
    )
    effect = Markup("<b>{}</b><br><small>{}</small>").format(
        effect_in_words(row.candidate), known.strength if known else ""
    )
    return [effect, values, f"{row.evidence.separation:.1f}"]


def _hypotheses(document: GapDocument, outside: float) -> Table:
    """What may be missing, with its probability."""
    rows: list[list[Cell]] = [
        [" + ".join(map(effect_in_words, h.effects)) or "nothing", in_percent(h.probability)]
        for h in document.hypotheses[:MOST_HYPOTHESES]
    ]
    rows.append(["something outside of the catalogue", in_percent(outside)])
    return Table("What may be missing", ["", "probability"], rows)


def _written(document: GapDocument) -> list[Part]:
    """Effects and values of the plant that was written, and why it lacks others."""
    written = document.written
    parts: list[Part] = [Paragraph(f"{_capitalised(written.reason)}.")] if written.reason else []
    if not written.parameters:
        return [*parts, Paragraph("The plant was written unchanged.")]
    rows: list[list[Cell]] = [
        [without_unit(name), amount(q)] for name, q in written.parameters.items()
    ]
    table = Table("", ["parameter", "value"], rows, "All other parameters are as before.")
    return [*parts, table]


def _capitalised(clause: str) -> str:
    return clause[0].upper() + clause[1:]


def _rejected(document: GapDocument) -> Table:
    by_reason: dict[str, list[str]] = {}
    for row in document.rejected:
        words = f"{effect_in_words(row.effect)} ({row.separation:.1f})"
        by_reason.setdefault(row.reason, []).append(words)
    rows: list[list[Cell]] = [
        [_capitalised(reason), ", ".join(names)] for reason, names in by_reason.items()
    ]
    return Table("", ["reason", "effects, with their d′"], rows)


# --- maps of where the gap is --------------------------------------------------------------------


def localisation_maps(cells: Sequence[GapRegion], learned: bool) -> list[Part]:
    """One table for each factor, all on one scale: noise floors, if one is learned."""
    unit = "noise floors" if learned else "times the mean of its spectrum"
    largest = max([c.size for c in cells if c.factor in FACTORS] + [1.5])
    note = (
        f"RMS of the residual after the nominal parameters were refitted, in {unit}. Only "
        "shaded values are significant, at a false-discovery rate of "
        f"{FRACTION.text(FALSE_DISCOVERY_RATE)}."
    )
    maps: list[Part] = [
        _map(title, regions, largest)
        for factor, title in FACTORS.items()
        if (regions := [c for c in cells if c.factor == factor])
    ]
    return [Paragraph(note, "note"), *maps]


def _map(title: str, regions: Sequence[GapRegion], largest: float) -> Table:
    levels = sorted({c.level for c in regions}, key=_level_order)
    by_place = {(c.signal, c.level): c for c in regions}
    rows: list[list[Cell]] = [
        [
            signal_words(signal),
            *(_shaded(by_place.get((signal, level)), largest) for level in levels),
        ]
        for signal in sorted({c.signal for c in regions})
    ]
    return Table(title, ["", *(_level_words(level) for level in levels)], rows)


def _shaded(region: GapRegion | None, largest: float) -> TableCell:
    """Size of a region, shaded by its logarithm from the noise to the largest."""
    if region is None:
        return TableCell("")
    text = f"{region.size:.0f}" if region.size >= 9.95 else f"{region.size:.1f}"
    if not region.significant:
        return TableCell(text)
    return TableCell(text, shade=math.log(max(region.size, 1.0)) / math.log(largest))


def _level_order(level: str) -> float:
    """Place of a level among the columns: by its number, or as listed."""
    number = re.match(r"[\d.]+", level)
    return float(number[0]) if number else float([*LEVELS, level].index(level))


def _level_words(level: str) -> str:
    return LEVELS.get(level, level.removesuffix(" Hz").replace(" to ", "–"))
