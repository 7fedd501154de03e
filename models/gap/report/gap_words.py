"""Gap document in words, for the console and the page."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from firmware_py.signals import without_unit
from models.gap.decision.posterior import DECIDED
from models.gap.decision.rejected_effects import UNEXCITED
from models.gap.report.effect_checks import effects_to_check, further_missing
from models.gap.report.gap_json import GapDocument, NamedEffect
from models.gap.report.next_step import (
    in_percent,
    is_plant_as_given,
    next_step_in_words,
    separated_in_words,
)
from models.gap.report.trial_notes import notes_in_words
from models.gap.settings import GapSettings

MOST_TOLD: Final = 3
"""Most effects, or sets of effects, listed where none is certain enough to be named."""

MOSTLY: Final = 3.0
"""Ratio of the changes in two joints above which an effect is reported for one joint [assumed]."""

TOLD_CHANGE: Final = 0.02
"""Least relative change of a link parameter that is reported [assumed]."""


def verdict_in_words(document: GapDocument) -> str:
    """Verdict as one or two sentences."""
    names = ", ".join(
        r.effect.replace("_", " ") + (f" of joint {joint}" if (joint := joint_of(r)) else "")
        for r in document.named
        if r.kept
    )
    if document.verdict == "no floor":
        return (f"Reduced by {names}. " if names else "Nothing was named. ") + unexplained_in_words(
            document
        )
    answers = document.answers
    if answers is not None and answers.catalogue < DECIDED:
        names += f" (probability {in_percent(answers.catalogue)})" if names else ""
    no_gap = "These trials show nothing that is missing."
    if answers is not None and answers.nothing < 0.5:
        missing = in_percent(1 - answers.nothing)
        no_gap = f"No effect can be named; that one is missing has a probability of {missing}."
    return {
        "no gap": no_gap + (f" {changed}" if (changed := change_in_words(document)) else ""),
        "closed": f"Closed by {names}.",
        "reduced": f"Reduced by {names}; {_left_in_words(document)}.",
        "not in the catalogue": _outside_in_words(document)
        + (f" {names.capitalize()} explains a part of it only." if names else ""),
    }[document.verdict]


def joint_of(row: NamedEffect) -> int | None:
    """Joint that an effect changed most; None where it changed both, or has one strength."""
    for name, first in row.parameters.items():
        second = row.parameters.get(re.sub(r"_1(?=_|$)", "_2", name))
        if "_1" not in name or second is None:
            continue
        changes = [abs(q.value - q.before) for q in (first, second)]
        if max(changes) > MOSTLY * min(changes):
            return 1 + changes.index(max(changes))
        return None
    return None


def change_in_words(document: GapDocument) -> str:
    """How the link changed since the plant was identified; empty where nothing was refitted."""
    changes = {n: q.value / q.before - 1 for n, q in document.refitted.items() if q.before}
    rows = ", ".join(
        f"{without_unit(name)} {change:+.0%}".replace("-", "−")
        for name, change in sorted(changes.items(), key=lambda row: -abs(row[1]))
        if abs(change) >= TOLD_CHANGE
    )
    return rows and (
        "But the link has changed since the plant was identified, and plant.json holds it as "
        f"refitted: {rows}."
    )


def _outside_in_words(document: GapDocument) -> str:
    """What is missing where no effect is named: something else, or an uncertain effect."""
    answers, effects = document.answers, document.effect_probabilities
    if answers is None:
        return "The missing effect is not in the catalogue."
    likely = [e for e, p in sorted(effects.items(), key=lambda row: -row[1]) if p > 1 - DECIDED]
    if not likely or answers.catalogue <= answers.outside:
        if answers.outside >= DECIDED:
            return "The missing effect is not in the catalogue."
        return (
            f"An effect that is not in the catalogue is missing with a probability of "
            f"{in_percent(answers.outside)}, nothing with {in_percent(answers.nothing)}."
        )
    named = ", ".join(f"{e.replace('_', ' ')} {in_percent(effects[e])}" for e in likely[:MOST_TOLD])
    return (
        "No effect is sure enough to be named. Effects of the catalogue are missing with a "
        f"probability of {in_percent(answers.catalogue)} ({named}), something outside of it with "
        f"{in_percent(answers.outside)}."
    )


def _left_in_words(document: GapDocument) -> str:
    """What remains beside the named effects."""
    further = further_missing(document)
    if further is None:
        return _largest_error_in_words(document)
    return (
        "more is left than noise and errors of the named equations explain. Of the catalogue "
        f"{further.effect.replace('_', ' ')} would take up most of it (by d′ "
        f"{further.separation:.0f}, noise and these errors by {further.least:.0f}), which is no "
        "proof that it is there"
    )


def _largest_error_in_words(document: GapDocument) -> str:
    """Signal with the largest error in noise floors, with the named effects."""
    errors = document.after.get("held_out", document.after["fitted"])
    sizes = {signal: row.floors for signal, row in errors.items() if row.floors is not None}
    if not sizes:
        return "a residual above the noise floor is left"
    signal = max(sizes, key=lambda name: sizes[name])
    return f"more than noise is left, in {signal} {sizes[signal]:.1f} noise floors"


def unexplained_in_words(document: GapDocument) -> str:
    """Unexplained fraction of the error, where no noise floor separates it from noise."""
    left = 1.0 if document.unexplained_fraction is None else document.unexplained_fraction
    return (
        "There is no noise floor, because no trial of the plant was repeated: "
        f"{left:.0%} of the plant's error is unexplained, and how much of that is noise is unknown."
    )


def floor_in_words(document: GapDocument) -> str:
    """Reference of the errors: a learned noise floor, or else the residual's spectrum."""
    return "noise floor" if document.noise_floor.learned else "residual's own spectrum"


def refusals_in_words(document: GapDocument) -> list[str]:
    """One sentence for each effect or value that was refused.

    Where nothing is named and several sets of effects were judged, one sentence lists their
    probabilities instead of a sentence for each refused effect.
    """
    judged = {} if any(row.kept for row in document.named) else _judged_sets(document)
    result = [_judged_in_words(judged)] if len(judged) > 1 else []
    for row in document.refused:
        if result and row.kind in ("stand-in", "improbable"):
            continue
        if row.kind == "not written":
            effect = row.effect.replace("_", " ")
            named = "are named, but their" if " + " in effect else "is named, but its"
            result.append(f"{effect} {named} plant is not written: {row.reason}.")
        elif row.effect:
            result.append(f"{row.effect.replace('_', ' ')} was refused: {row.reason}.")
        else:
            result.append(f"refitted, {row.reason}; {_kept_in_words(document, row.name)}.")
    return [text[0].upper() + text[1:] for text in dict.fromkeys(result)]


def _kept_in_words(document: GapDocument, parameter: str) -> str:
    """Value that plant.json holds for a refitted parameter that was undone."""
    for row in document.named:
        if row.kept and parameter in row.parameters:
            q = row.parameters[parameter]
            return f"plant.json holds {q.value:.4g}{q.unit_in_words}, where the fit began"
    return "plant.json keeps the value of the plant as given"


def _judged_sets(document: GapDocument) -> dict[str, float]:
    """Probability of each set of effects that was judged, the most probable first."""
    rows = sorted(document.tested, key=lambda row: -row.answers.catalogue)
    found: dict[str, float] = {}
    for row in rows:
        if row.effects:
            found.setdefault(" + ".join(sorted(row.effects)), row.answers.catalogue)
    return found


def _judged_in_words(judged: Mapping[str, float]) -> str:
    """Sentence on sets of effects none of which is certain enough."""
    likeliest = list(judged.items())[:MOST_TOLD]
    listed = ", ".join(f"{name.replace('_', ' ')} {in_percent(p)}" for name, p in likeliest)
    return f"none of {len(judged)} answers is sure enough to be named; the likeliest: {listed}."


def probabilities_in_words(document: GapDocument) -> str:
    """Probabilities of the three answers and of each effect; empty without a noise floor."""
    answers = document.answers
    if answers is None:
        return ""
    rows = ", ".join(
        f"{effect.replace('_', ' ')} {in_percent(probability)}"
        for effect, probability in document.effect_probabilities.items()
        if probability > 1 - DECIDED
    )
    return (
        f"Probabilities: nothing is missing {in_percent(answers.nothing)}; effects of the "
        f"catalogue are {in_percent(answers.catalogue)}{rows and f' ({rows})'}; something else is "
        f"{in_percent(answers.outside)}."
    )


def gap_in_words(document: GapDocument, gap_json: str = "OUT/gap.json") -> str:
    """Gap document as text for the console.

    Parameters
    ----------
    document : GapDocument
        Document of a diagnosis.
    gap_json : str
        Path of its file, named in the next step.

    Returns
    -------
    str
        Verdict, notes, named effects, refusals and the next step, one per line.
    """
    lines = [f"verdict: {document.verdict}", verdict_in_words(document), document.sentence]
    lines += notes_in_words(document)
    for row in document.named:
        lines += _named_in_words(row, document.settings)
    if said := probabilities_in_words(document):
        lines.append(said)
    lines += refusals_in_words(document)
    if document.refused and is_plant_as_given(document):
        lines.append("The plant that was written is the plant as given, unchanged.")
    if document.verdict in ("reduced", "not in the catalogue"):
        lines.append("remaining gap: " + document.remaining.sentence)
    part = "held_out" if "held_out" in document.before else "fitted"
    size = "in noise floors" if document.noise_floor.learned else "per residual's own spectrum"
    lines.append(
        f"{part.replace('_', '-')} trials, {size}, before and after (with what varies between "
        "trials, as the mocap frame, which the floor leaves out):"
    )
    for signal, before in document.before[part].items():
        after = document.after[part].get(signal, before)
        lines.append(f"  {signal:14s}{_floors(before.floors)}{_floors(after.floors)}")
    unexcited = [r.effect for r in document.rejected if r.reason == UNEXCITED]
    if unexcited:
        lines.append("not excited: " + ", ".join(unexcited))
    for effect, check in effects_to_check(document).items():
        lines.append(f"check on the robot, for {effect.replace('_', ' ')}: {check}")
    lines.append("next: " + next_step_in_words(document, gap_json))
    return "\n".join(lines)


def _named_in_words(row: NamedEffect, settings: GapSettings) -> list[str]:
    """Lines on an effect: its values, its look-alikes and whether its strength is consistent."""
    if not row.kept:
        return [f"found, then refused: {row.effect} (d′ {row.evidence.separation:.1f})"]
    values = ", ".join(
        f"{name} = {q}{q.unit_in_words}{q.bound_in_words}"
        + (f", before {q.before:.4g}" if q.before else "")
        for name, q in row.parameters.items()
    )
    lines = [f"named: {row.effect} (d′ {row.evidence.separation:.1f}); {values}"]
    if row.look_alikes:
        others = ", ".join(c.effect for c in row.look_alikes)
        lines.append(
            f"  these trials cannot tell {row.effect} from {others}; "
            + separated_in_words(row.separated_by, settings)
        )
    if not row.evidence.strength_holds:
        differs = row.evidence.strength_standard_deviation
        lines.append(
            f"  its strength would have to differ by {differs:.0%} between payloads, signals "
            "and frequencies: it may stand in for another effect, or its equation is too simple"
        )
    return lines


def _floors(value: float | None) -> str:
    return f"{'-' if value is None else format(value, '.2f'):>10s}"
