"""Page of a diagnosis (`report.html`): no outside files, its pictures inline SVG.

Everything comes from gap.json, the two plants and the trials, so that whoever has those files can
draw the same page again and add sections to it (`hil.report.gap.before_after_page`).
"""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.display_units import error_unit
from models.gap.report.gap_json import (
    GapDocument,
    MappedRegion,
    NamedEffect,
    NamingEvidence,
    SignalGap,
)
from models.gap.report.gap_words import goal_not_followed_in_words, nuisance_bias_in_words
from models.gap.residuals.localisation import signal_in_words
from models.gap.residuals.spectrum import Array
from models.plant.identification.evaluation import TIP, Comparison, compare_with_trials
from models.plant.plant import Plant
from models.shared import svg_charts
from models.shared.catalogue import CATALOGUE
from models.shared.html_page import Section, page_of, panels_of, readable, table_of
from models.shared.palette import AFTER, BEFORE, MUTED
from models.trials.trial import Trial
from models.trials.trial_files import TrialSet

FACTORS: Final = {
    "phase": "Phase of the cycle", "stroke": "Stroke", "payload": "Payload",
    "band": "Frequency, Hz", "angle": "Angle", "direction": "Direction",
}  # fmt: skip
_SHORT: Final = {
    "way out to positive angles": "out to +", "return from positive angles": "back from +",
    "way out to negative angles": "out to −", "return from negative angles": "back from −",
    "towards +": "to +", "towards −": "to −",
}  # fmt: skip
RIVALS: Final = 8


def write_gap_page(
    document: GapDocument, before: Plant, after: Plant, trials: TrialSet, path: Path
) -> Path:
    """Write the page of a diagnosis.

    Parameters
    ----------
    document : GapDocument
        Of the diagnosis.
    before, after : Plant
        As given, and as improved.
    trials : TrialSet
        Where the gap was looked for.
    path : Path
        Page to write; returned.
    """
    title = "The gap between plant and measurement"
    parts = gap_sections(document, before, after, trials)
    path.write_text(page_of(title, gap_lead(document), parts), encoding="utf-8")
    return path


def gap_lead(document: GapDocument) -> str:
    """Verdict, location of the gap in one sentence, and the tip's error before and after."""
    text = html.escape(document.sentence)
    for note in (goal_not_followed_in_words(document), nuisance_bias_in_words(document)):
        text += f" {html.escape(note[0].upper() + note[1:])}." if note else ""
    before_m, after_m = (_tip_m(errors) for errors in (document.before, document.after))
    if document.named and before_m:
        text += (
            f" The error of the plant's tip is {readable(before_m, 'm')} before and "
            f"{readable(after_m, 'm')} after."
        )
    return f'<p class="lead"><b>{_verdict(document)}</b> {text}</p>'


def gap_sections(
    document: GapDocument,
    before: Plant,
    after: Plant,
    trials: TrialSet,
    hidden: Mapping[str, float] | None = None,
) -> list[Section]:
    """Sections of the page of a diagnosis.

    Parameters
    ----------
    document : GapDocument
        Of the diagnosis.
    before, after : Plant
        As given, and as improved.
    trials : TrialSet
        Where the gap was looked for.
    hidden : mapping of str to float, optional
        Strength of each hidden effect, shown beside the result where it is known.
    """
    rate = document.settings.false_discovery_rate
    result = [
        Section(
            "where", "Location of the gap", _where(document.map, trials),
            "Root mean square of the residual after the nominal parameters were refitted, in noise "
            "floors: 1 is noise. Grey figures are not significant under a false-discovery rate of "
            f"{100 * rate:g} %.",
        ),
        Section(
            "what", "Missing effects", _named(document, hidden) + _rivals(document),
            "d′: distance from a plant without the effect, in standard deviations of the noise "
            "floor. The d′ that each effect needs was measured where nothing is missing; the bars "
            "show the ratio to it. A strength that differs much between payloads, signals and "
            "frequencies indicates another effect.",
        ),
    ]  # fmt: skip
    if document.waterfall:
        steps = [(step.step, step.floors) for step in document.waterfall]
        result.append(
            Section(
                "waterfall",
                "Error after each step",
                panels_of([("", svg_charts.waterfall(steps))]),
                "Root mean square of all signals in noise floors, on repetitions that no value was "
                "fitted to: the plant as given, its nominal parameters refitted, and every effect "
                "in turn. Pale: what the step removed.",
            )
        )
    result.append(_compared(document, before, after, trials))
    result.append(Section("others", "Effects not named", _rejected(document)))
    return result


def _tip_m(errors: Mapping[str, Mapping[str, SignalGap]]) -> float:
    """Root mean square distance of the tip, over the last trials; zero where there is no tip."""
    rows = errors.get("held_out", errors["fitted"])
    return float(np.sqrt(sum(rows[axis].rms ** 2 for axis in TIP if axis in rows)))


def _verdict(document: GapDocument) -> str:
    names = ", ".join(_words(r.effect) for r in document.named if r.kept)
    return {
        "no gap": "No gap.",
        "closed": f"Closed by {names}.",
        "reduced": f"Reduced by {names}; a part of the gap is left.",
        "not in the catalogue": "The missing effect is not in the catalogue."
        + (f" {names.capitalize()} can only stand in for it." if names else ""),
    }[document.verdict]


def _words(name: str) -> str:
    return html.escape(name.replace("_", " "))


def _where(cells: Sequence[MappedRegion], trials: TrialSet) -> str:
    """One heat map for every factor, all on one scale of colours."""
    most = max([c.size for c in cells if c.factor in FACTORS] + [1.5])
    signals = sorted({c.signal for c in cells})
    panels = []
    for factor, title in FACTORS.items():
        own = [c for c in cells if c.factor == factor]
        if not own:
            continue
        levels = sorted({c.level for c in own}, key=_order)
        place = {c.level: _SHORT.get(c.level, _plain(c.level)) for c in own}
        rows = {c.signal: short_signal(c.signal) for c in own}
        drawing = svg_charts.heat_map(
            [rows[s] for s in signals if s in rows], [place[level] for level in levels],
            {(rows[c.signal], place[c.level]): c.size for c in own},
            78, width=svg_charts.WIDTH, most=most,
            quiet={(rows[c.signal], place[c.level]) for c in own if not c.significant},
            above=_cycle(trials[0]) if factor == "phase" else None,
        )  # fmt: skip
        panels.append((title, drawing))
    return f'<div class="key">{svg_charts.scale_of(most)}</div>' + panels_of(panels)


def _order(level: str) -> tuple[float, str]:
    """Sort key: levels with a number by it, others out before back and minus before plus."""
    number = re.match(r"[\d.]+", level)
    if number:
        return float(number[0]), level
    order = [*_SHORT, "negative", "middle", "positive"]
    return float(order.index(level) if level in order else len(order)), level


def _plain(level: str) -> str:
    return level.removesuffix(" Hz").replace(" to ", "–")


def _cycle(trial: Trial) -> Array:
    """The first joint over one cycle of the motion, its largest excursion one."""
    start = trial.meta.rest_samples
    joint = trial.joint[start : start + round(trial.meta.period_s / trial.step_s), 0]
    return np.asarray(joint[:: max(1, len(joint) // 80)] / max(float(np.abs(joint).max()), 1e-9))


def short_signal(signal: str) -> str:
    """A signal in a word or two."""
    stem = signal.rsplit("_", 1)[0]
    return "DI" if signal == "di" else stem.replace("_", " ")


def _named(document: GapDocument, hidden: Mapping[str, float] | None) -> str:
    if not document.named:
        return "<p>Nothing.</p>"
    head = ["effect", "value found", "d′", "strength differs by", "cannot be told from"]
    if hidden is not None:
        head.insert(1, "hidden")
    return table_of(head, [_named_row(entry, hidden) for entry in document.named])


def _named_row(entry: NamedEffect, hidden: Mapping[str, float] | None) -> list[str]:
    effects = entry.effect.split(" + ")
    meaning = "; ".join(CATALOGUE[e].strength for e in effects if e in CATALOGUE)
    values = "<br>".join(
        f"{_words(name)} {q.value:.3g} ± {q.error or 0:.2g} {_unit(q.unit)} (was {q.before:.3g})"
        for name, q in entry.parameters.items()
    )
    alike = ", ".join(_words(c.effect) for c in entry.look_alikes) or "nothing"
    if entry.separated_by:
        alike += f"; {_words(entry.separated_by.motion)} would tell them apart"
    row = [
        f"<b>{_words(entry.effect)}</b><br><small>{html.escape(meaning)}</small>", values,
        f"{entry.evidence.separation:.1f}", _differs(entry.evidence), alike,
    ]  # fmt: skip
    if hidden is not None:
        known = [f"{hidden[e]:g} {_unit(CATALOGUE[e].unit)}" for e in effects if e in hidden]
        row.insert(1, "<br>".join(known) or "nothing")
    return row


def _differs(evidence: NamingEvidence) -> str:
    """Difference of the strength between payloads, signals and frequencies."""
    size = f"{100 * evidence.strength_standard_deviation:.0f} %"
    return size if evidence.strength_holds else f"<b>{size}: a stand-in</b>"


def _unit(unit: str) -> str:
    return "" if unit == "1" else html.escape(unit)


def _rivals(document: GapDocument) -> str:
    """Named effects beside the next ones, each alone."""
    named = [
        (_words(r.effect), r.evidence.separation / r.evidence.least) for r in document.named[:1]
    ]
    others = [(_words(r.effect), r.separation / r.least) for r in document.rejected]
    rows = named + sorted(others, key=lambda row: -row[1])[: RIVALS - len(named)]
    if not rows:
        return ""
    title = "d′ of each effect alone, as a multiple of what it needs to be named"
    return panels_of([(title, svg_charts.bars(rows, "", 1.0, "needed"))])


def _rejected(document: GapDocument) -> str:
    by_reason: dict[str, list[str]] = {}
    for row in document.rejected:
        by_reason.setdefault(row.reason, []).append(f"{_words(row.effect)} ({row.separation:.1f})")
    rows = [[html.escape(reason), ", ".join(names)] for reason, names in by_reason.items()]
    return table_of(["reason", "effects, with their d′"], rows)


def _compared(document: GapDocument, before: Plant, after: Plant, trials: TrialSet) -> Section:
    """Error of both plants, by signal and on the heaviest of the last trials."""
    part = "held_out" if "held_out" in document.before else "fitted"
    rows = [
        [
            html.escape(signal_in_words(signal)), readable(row.rms, row.unit),
            readable(document.after[part][signal].rms, row.unit),
            readable(row.rms / row.floors, row.unit) if row.floors else "",
        ]
        for signal, row in document.before[part].items()
    ]  # fmt: skip
    trial = max(trials.split()[1] or trials, key=lambda t: t.meta.payload_kg)
    both = [compare_with_trials(plant, [trial])[0] for plant in (before, after)]
    key = svg_charts.legend([(BEFORE, "before"), (AFTER, "after"), (MUTED, "noise floor")])
    return Section(
        "residual", "Before and after",
        table_of(["root mean square error", "before", "after", "noise floor"], rows)
        + key + panels_of(_residuals(document.before[part], both)),
        "Table: repetitions under every payload. Curves: measured minus simulated in "
        f"{html.escape(trial.name)}.",
    )  # fmt: skip


def _residuals(
    before: Mapping[str, SignalGap], both: Sequence[Comparison]
) -> list[tuple[str, str]]:
    panels = []
    for signal in both[0].simulated:
        series = [-c.error(signal) for c in both]
        still = all(np.ptp(c.simulated[signal]) == 0 for c in both)  # across a single joint's plane
        if still or not np.nanmax(np.abs(series[0])) > 0 or signal not in before:
            continue
        row = before[signal]
        unit, factor, _ = error_unit(row.unit)
        named = list(zip(("before", "after"), (factor * s for s in series), strict=True))
        floor = factor * row.rms / row.floors if row.floors else None
        drawing = svg_charts.traces(both[0].trial.time_s, named, unit, floor)
        sizes = " → ".join(f"{np.sqrt(np.nanmean(values**2)):.3g}" for _, values in named)
        panels.append((f"{short_signal(signal)}, {sizes} {unit} RMS", drawing))
    return panels
