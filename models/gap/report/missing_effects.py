"""Missing effects on the page of a diagnosis: those named, and the next best ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from markupsafe import Markup

from firmware_py.display_units import FRACTION, symbol_of
from models.gap.report.gap_charts import draw_bars
from models.gap.report.gap_json import GapDocument, NamedEffect, NamingEvidence
from models.gap.report.next_step import separated_in_words
from models.gap.settings import GapSettings
from models.shared.catalogue import CATALOGUE, EVERY_EFFECT, effect_and_joint
from models.shared.drawing import Drawing
from models.shared.pages import Cell, Figure, Paragraph, Part, Table

MOST_COMPARED: Final = 8
"""Most effects in the figure."""


def named_effects(document: GapDocument, hidden: Mapping[str, float] | None) -> list[Part]:
    """Table of the effects that are named, and of those that were taken out again.

    `hidden` holds effects that were hidden on a rig and their strengths; it adds a column.
    """
    kept = [_row(entry, hidden, document.settings) for entry in document.named if entry.kept]
    taken_out = [
        _row(entry, hidden, document.settings) for entry in document.named if not entry.kept
    ]
    head = ["effect", "value found", "d′", "strength differs by", "look-alikes"]
    if hidden is not None:
        head.insert(1, "hidden")
    parts: list[Part] = [Table("", head, kept) if kept else Paragraph("No effect is named.")]
    if taken_out:
        parts.append(Table("Found by the search, and taken out again", head, taken_out))
    return parts


def _row(
    entry: NamedEffect, hidden: Mapping[str, float] | None, settings: GapSettings
) -> list[Cell]:
    effects = entry.effect.split(" + ")
    meaning = "; ".join(EVERY_EFFECT[e].strength for e in effects if e in EVERY_EFFECT)
    values = Markup("<br>").join(
        f"{_words(name)} {q} {symbol_of(q.unit)}{q.bound_in_words} (before: {q.before:.3g})"
        for name, q in entry.parameters.items()
    )
    alike = ", ".join(_words(c.effect) for c in entry.look_alikes) or "none"
    if entry.look_alikes and entry.kept:
        alike += f"; {separated_in_words(entry.separated_by, settings)}"
    effect = Markup("<b>{}</b><br><small>{}</small>").format(_words(entry.effect), meaning)
    row: list[Cell] = [
        effect, values if entry.kept else "not written", f"{entry.evidence.separation:.1f}",
        _consistency(entry.evidence), alike,
    ]  # fmt: skip
    if hidden is not None:
        told = [
            f"{strength:g} {symbol_of(CATALOGUE[e].unit)}".strip()
            + (f", joint {joint}" if joint else "")
            for (e, joint), strength in ((effect_and_joint(h), s) for h, s in hidden.items())
            if e in effects
        ]
        row.insert(1, Markup("<br>").join(told) or "nothing")
    return row


def _consistency(evidence: NamingEvidence) -> str | Markup:
    """How much the strength differs between payloads, signals and frequencies."""
    spread = FRACTION.text(evidence.strength_standard_deviation)
    if evidence.strength_holds:
        return spread
    return Markup("<b>{}: not consistent</b>").format(spread)


def compared_effects(document: GapDocument) -> list[Figure]:
    """Figure of the first included effect beside those that explain the gap next best,
    each alone.
    """
    found = [(r.effect, r.evidence.separation / r.evidence.least) for r in document.named[:1]]
    others = [
        (r.effect, r.separation / r.least) for r in document.rejected
        if r.effect not in dict(found)
    ]  # fmt: skip
    found += sorted(others, key=lambda row: -row[1])[: MOST_COMPARED - len(found)]
    rows = [(_words(effect), ratio) for effect, ratio in found]
    if not rows:
        return []
    marked = len([r for r in document.named[:1] if r.kept])
    with Drawing(0.8 + 0.26 * len(rows)) as (drawing, ax):
        draw_bars(ax, rows, 1.0, "d′ over the d′ needed", marked)
    listed = ", ".join(f"{label} {value:.1f}" for label, value in rows)
    title = "How well each effect alone explains the gap"
    return [Figure("", "", [drawing.panel(title, f"Ratio of d′ to the d′ needed: {listed}.")])]


def _words(name: str) -> str:
    return name.replace("_", " ")
