"""Gap document in words, for the console and the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from firmware_py.signals import without_unit
from models.gap.decision.further_effect import FurtherEffect
from models.gap.decision.posterior import DECIDED
from models.gap.decision.rejected_effects import UNEXCITED
from models.gap.report.effect_checks import effects_to_check
from models.gap.report.gap_json import GapDocument, NamedEffect
from models.gap.report.trial_notes import notes_in_words

MOST_TOLD: Final = 3
"""Effects, or sets of these, that are told where none is sure enough to be named."""

TOLD_CHANGE: Final = 0.02
"""Change of a parameter of the link, as a fraction, from which it is told [assumed]."""


def verdict_in_words(document: GapDocument) -> str:
    """Verdict as one or two sentences."""
    names = ", ".join(r.effect.replace("_", " ") for r in document.named if r.kept)
    if document.verdict == "no floor":
        return (f"Reduced by {names}. " if names else "Nothing was named. ") + unexplained_in_words(
            document
        )
    answers = document.answers
    if answers is not None and answers.catalogue < DECIDED:
        names += f" (probability {_percent(answers.catalogue)})" if names else ""
    no_gap = "These trials show nothing that is missing."
    if answers is not None and answers.nothing < 0.5:
        missing = _percent(1 - answers.nothing)
        no_gap = f"No effect can be named; that one is missing has a probability of {missing}."
    return {
        "no gap": no_gap + (f" {changed}" if (changed := change_in_words(document)) else ""),
        "closed": f"Closed by {names}.",
        "reduced": f"Reduced by {names}; {_left_in_words(document)}.",
        "not in the catalogue": _outside_in_words(document)
        + (f" {names.capitalize()} explains a part of it only." if names else ""),
    }[document.verdict]


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
    """What is missing where no name is given: something else, or an effect that is not sure."""
    answers, effects = document.answers, document.effect_probabilities
    if answers is None:
        return "The missing effect is not in the catalogue."
    likely = [e for e, p in sorted(effects.items(), key=lambda row: -row[1]) if p > 1 - DECIDED]
    if not likely or answers.catalogue <= answers.outside:
        if answers.outside >= DECIDED:
            return "The missing effect is not in the catalogue."
        return (
            f"An effect that is not in the catalogue is missing with a probability of "
            f"{_percent(answers.outside)}, nothing with {_percent(answers.nothing)}."
        )
    named = ", ".join(f"{e.replace('_', ' ')} {_percent(effects[e])}" for e in likely[:MOST_TOLD])
    return (
        "No effect is sure enough to be named. Effects of the catalogue are missing with a "
        f"probability of {_percent(answers.catalogue)} ({named}), something outside of it with "
        f"{_percent(answers.outside)}."
    )


def _left_in_words(document: GapDocument) -> str:
    """What is left beside the named effects."""
    further = _further_missing(document)
    if further is None:
        return "a residual above the noise floor is left"
    return (
        "more is left than noise and errors of the named equations explain. Of the catalogue "
        f"{further.effect.replace('_', ' ')} would take up most of it (by d′ "
        f"{further.separation:.0f}, noise and these errors by {further.least:.0f}), which is no "
        "proof that it is there"
    )


def _further_missing(document: GapDocument) -> FurtherEffect | None:
    """Effect that would explain more beside the named ones than noise and their equations miss."""
    further = document.tested[-1].further if document.tested else None
    return further if further is not None and further.is_missing else None


def unexplained_in_words(document: GapDocument) -> str:
    """Fraction of the error that is unexplained, where no noise floor tells it from noise."""
    left = 1.0 if document.unexplained_fraction is None else document.unexplained_fraction
    return (
        "There is no noise floor, because no trial of the plant was repeated: "
        f"{left:.0%} of the plant's error is unexplained, and how much of that is noise is unknown."
    )


def floor_in_words(document: GapDocument) -> str:
    """Name of what the errors are compared with: a learned noise floor, or a spectrum in its place.

    Parameters
    ----------
    document : GapDocument
        Of a diagnosis.
    """
    return "noise floor" if document.noise_floor.learned else "residual's own spectrum"


def refusals_in_words(document: GapDocument) -> list[str]:
    """One sentence for each effect or value that was refused.

    Where nothing is named and several sets of effects were judged one sentence has their
    probabilities, in place of one for each effect that was left out of them.
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
            result.append(
                f"refitted, {row.reason}; plant.json keeps the value of the plant as given."
            )
    return [text[0].upper() + text[1:] for text in dict.fromkeys(result)]


def _judged_sets(document: GapDocument) -> dict[str, float]:
    """Probability of each set of effects that was judged, the likeliest first."""
    rows = sorted(document.tested, key=lambda row: -row.answers.catalogue)
    found: dict[str, float] = {}
    for row in rows:
        if row.effects:
            found.setdefault(" + ".join(sorted(row.effects)), row.answers.catalogue)
    return found


def _judged_in_words(judged: Mapping[str, float]) -> str:
    """Sentence on sets of effects none of which is sure enough."""
    likeliest = list(judged.items())[:MOST_TOLD]
    listed = ", ".join(f"{name.replace('_', ' ')} {_percent(p)}" for name, p in likeliest)
    return f"none of {len(judged)} answers is sure enough to be named; the likeliest: {listed}."


def is_plant_as_given(document: GapDocument) -> bool:
    """Whether the plant that was written is the one as given."""
    named = {e for row in document.named if row.kept for e in row.effect.split(" + ")}
    return not (document.refitted or named - _withheld(document))


def _withheld(document: GapDocument) -> set[str]:
    rows = [row for row in document.refused if row.kind == "not written"]
    return {effect for row in rows for effect in row.effect.split(" + ")}


def probabilities_in_words(document: GapDocument) -> str:
    """Probabilities of the three answers, and of each effect; empty without a noise floor."""
    answers = document.answers
    if answers is None:
        return ""
    rows = ", ".join(
        f"{effect.replace('_', ' ')} {_percent(probability)}"
        for effect, probability in document.effect_probabilities.items()
        if probability > 1 - DECIDED
    )
    return (
        f"Probabilities: nothing is missing {_percent(answers.nothing)}; effects of the catalogue "
        f"are {_percent(answers.catalogue)}{rows and f' ({rows})'}; something else is "
        f"{_percent(answers.outside)}."
    )


def _percent(probability: float) -> str:
    """Probability as a person reads it: no finite number of trials gives 0 or 100 %."""
    return "<1%" if probability < 0.01 else f"{min(probability, 0.99):.0%}"


def next_step_in_words(document: GapDocument) -> str:
    """What the user does next, in one sentence; odd trials come first."""
    if not document.odd_trials:
        return _next_step_of_the_rest(document)
    names = ", ".join(o.name for o in document.odd_trials)
    return (
        f"Check payload_kg, conditions and recording of {names} (python -m models validate), "
        f"mend or repeat it, and run gap again. Without it: {_next_step_of_the_rest(document)}"
    )


def _next_step_of_the_rest(document: GapDocument) -> str:
    """The same, by what the other trials show."""
    if document.verdict == "no floor":
        return "Repeat at least one trial: only repetitions tell noise from error."
    if document.verdict == "not in the catalogue":
        return _next_step_outside(document)
    if not any(row.kept for row in document.named):
        answers = document.answers
        if answers is None or answers.nothing >= DECIDED:
            if document.refitted:
                return "Use the refitted plant: train a bundle with it (python -m models train)."
            return "Nothing: the plant explains these trials."
        refitted = "plant.json holds the refitted link, the better plant so far. "
        return (
            f"{refitted if document.refitted else ''}Record another motion or payload, or more "
            f"repetitions: with a probability of {_percent(1 - answers.nothing)} something is "
            "missing that these trials show too faintly to be named."
        )
    undecided = [
        effect.replace("_", " ")
        for effect, probability in document.effect_probabilities.items()
        if 1 - DECIDED < probability < DECIDED
    ]
    if undecided:
        return (
            f"These trials do not decide on {', '.join(undecided)}: 'python -m models experiment "
            "--gap OUT/gap.json --limits robot.toml --out MOTION.toml' designs the one that does."
        )
    further = _further_missing(document)
    refused = {row.effect for row in document.refused}
    if further is not None and further.effect not in refused:
        return (
            "Record another motion or payload: these trials do not decide whether "
            f"{further.effect.replace('_', ' ')} is missing too."
        )
    if is_plant_as_given(document):
        return (
            "Identify the plant again on these trials, or record another motion or payload: with "
            "the effect alone the plant as given would not err less on what was left out."
        )
    if lacks := _withheld(document):
        lacking = ", ".join(sorted(effect.replace("_", " ") for effect in lacks))
        return (
            f"Identify the plant again on these trials: the improved plant lacks {lacking}, with "
            "which it would not err less on what was left out."
        )
    return "Use the improved plant: train a bundle with it (python -m models train --plant)."


def _next_step_outside(document: GapDocument) -> str:
    """The same where something outside of the catalogue is likelier than nothing."""
    record = "Record another motion or payload, so that more is left out"
    answers = document.answers
    if answers is None or answers.nothing <= 1 - DECIDED:
        return f"{record}, or describe the effect in one file (models/plant/effects)."
    if document.settings.same_link:
        return f"{record}."
    return (
        f"{record}. If the link may have changed since, identify the plant again first: a changed "
        "link adds to the plant's own error."
    )


def gap_in_words(document: GapDocument) -> str:
    """Text for the console.

    Parameters
    ----------
    document : GapDocument
        Of a diagnosis.
    """
    lines = [f"verdict: {document.verdict}", verdict_in_words(document), document.sentence]
    lines += notes_in_words(document)
    for row in document.named:
        lines += _named_in_words(row)
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
    lines.append("next: " + next_step_in_words(document))
    return "\n".join(lines)


def _named_in_words(row: NamedEffect) -> list[str]:
    """An effect with its values, its look-alikes and whether its strength is consistent."""
    values = ", ".join(
        f"{name} = {q} {q.unit}{q.bound_in_words}" for name, q in row.parameters.items()
    )
    word = "named" if row.kept else "found, then refused"
    lines = [f"{word}: {row.effect} (d′ {row.evidence.separation:.1f})"]
    if row.kept:
        lines[0] += f"; {values}"
    if row.separated_by:
        others = ", ".join(c.effect for c in row.look_alikes)
        lines.append(
            f"  these trials cannot tell it from {others}; {row.separated_by.motion} would"
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
