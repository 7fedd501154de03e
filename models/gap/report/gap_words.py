"""Gap document in words, for the console and the page."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from typing import Final

from firmware_py.core.signals import without_unit
from firmware_py.core.units import DURATION, DisplayUnit, error_unit
from models.gap.decision.certainty import DECIDED, LEAST_SEPARATION
from models.gap.report.gap_json import (
    FittedValue,
    GapDocument,
    NamedEffect,
    RefusedEffects,
    SignalGap,
    largest_gaps,
)
from models.gap.residuals.localisation import groups_in_words, signal_in_words
from models.shared.catalogue import EVERY_EFFECT, effect_and_joint

MOSTLY: Final = 3.0
"""Ratio of the changes in two joints above which an effect counts as one of a single joint
[assumed]."""
OTHER_STRENGTH: Final = 0.25
"""Relative difference of the written strength from the named one that is reported [assumed]."""
REPORTED_CHANGE: Final = 0.02
"""Least relative change of a link parameter that is reported [assumed]."""
MOST_LISTED: Final = 4
"""Most signals, look-alikes or effects in one place."""
GENERAL_CHECK: Final = (
    "Change it on the robot on purpose, or take its cause away, and record a trial again."
)
"""Check of an effect that is not in the catalogue, such as one in a file of the user."""
MOST_CHECKS: Final = 5
"""Most effects that are listed."""
CHANGED: Final = {
    "step_s": "Rows are {here} apart, {known} in the trials of the plant: right if the robot sent "
    "its goals at this step, wrong if the rows were resampled.",
    "payload_kg": "The plant was identified with {known} kg, not with {here} kg, so effects must "
    "be larger to be named there; identify it with these payloads too.",
    "pressure_pa": "The pressure is {here} Pa, {known} Pa in the trials of the plant: a change of "
    "the link is no missing effect.",
}  # fmt: skip
"""What differs from the trials of the plant, and its consequence, by condition."""


def effect_in_words(candidate: str) -> str:
    """Effect, with its joint where it is one of a single servo."""
    effect, joint = effect_and_joint(candidate)
    return effect.replace("_", " ") + (f" of joint {joint}" if joint else "")


def joined(words: Sequence[str], last: str = "and") -> str:
    *rest, end = words or [""]
    return f"{', '.join(rest)} {last} {end}" if rest else end


def in_percent(probability: float) -> str:
    """Probability in per cent, never 0 or 100 %: no finite number of trials proves either."""
    return "<1%" if probability < 0.01 else f"{min(probability, 0.99):.0%}"


def amount(value: FittedValue) -> str:
    """Value with its standard error, and the value before unless that is zero."""
    unit = _unit(value.unit)
    error = "" if value.error is None else f" ± {unit.factor * value.error:.2g}"
    after = f"{unit.factor * value.value:.3g}{error} {unit.name}".strip()
    before = f"from {unit.factor * value.before:.3g} to " if value.before else ""
    return (before + after).replace("-", "−")


def _unit(unit: str) -> DisplayUnit:
    return DURATION if unit == "s" else error_unit(unit)


def strength_of(row: NamedEffect) -> tuple[int | None, str]:
    """Parameter of the strength that changed most, and its joint if it is one of a single joint."""
    first = next(iter(row.parameters))
    names = {joint: re.sub(r"_1(?=_|$)", f"_{joint}", first) for joint in (1, 2)}
    change = {
        joint: abs(row.parameters[name].value - row.parameters[name].before)
        for joint, name in names.items()
        if name in row.parameters
    }
    most = max(change, key=lambda joint: change[joint])
    is_single = names[1] != names[2] and change[most] > MOSTLY * min(change.values())
    return row.joint or (most if is_single else None), names[most]


# What is wrong, how sure that is, and how much better the plant is ------------------------------


def headline(document: GapDocument) -> str:
    """Names with values and probabilities, verdict, the better signal, and what is not written."""
    parts = [_names_in_words(document), _verdict_in_words(document)]
    parts += [*_better(document), *_written_otherwise(document)]
    not_written = [row for row in document.refused if row.kind == "not written"]
    parts += [
        f"{joined([effect_in_words(e) for e in row.effects])} is not written to the plant: "
        f"{row.reason}."
        for row in not_written
    ]
    return " ".join(p[0].upper() + p[1:] for p in parts if p)


def _names_in_words(document: GapDocument) -> str:
    if not document.named:
        return ""
    probabilities = [document.effect_probabilities.get(row.candidate) for row in document.named]
    is_sure = all(p is None or p >= DECIDED for p in probabilities)
    names = "; ".join(_name_in_words(document, row) for row in document.named)
    return f"{'Missing' if is_sure else 'Probably missing'}: {names}."


def _name_in_words(document: GapDocument, row: NamedEffect) -> str:
    joint, strength = strength_of(row)
    words = effect_in_words(f"{row.effect}:{joint}" if joint else row.effect)
    words += f" {amount(row.parameters[strength])}"
    known = EVERY_EFFECT.get(row.effect)
    about = [known.strength] if known and len(document.named) == 1 else []
    if document.probabilities is not None:
        probability = document.effect_probabilities.get(row.candidate, 0.0)
        about.append(f"probability {in_percent(probability)}")
    return f"{words} ({', '.join(about)})" if about else words


def _verdict_in_words(document: GapDocument) -> str:
    known, named = document.probabilities, document.named
    it, explain = ("They", "explain") if len(named) > 1 else ("It", "explains")
    match document.verdict:
        case "closed":
            return f"{it} {explain} the gap; the rest is noise."
        case "reduced":
            return f"{it} {explain} a part of the gap; more than noise remains."
        case "no floor":
            fraction = document.held_out.fraction
            better = f"the held-out error falls to {fraction:.0%}, but " if named else ""
            nothing = "" if named else "Nothing is named. "
            return (
                f"{nothing}The plant has no noise floor, which dropstitch identify measures on "
                f"repeated trials: {better}noise and model error cannot be separated."
            )
        case "not in the catalogue":
            sure = f" (probability {in_percent(known.outside)})" if known else ""
            return f"Something is missing that is not in the catalogue{sure}."
    if known is not None and known.nothing < 0.5:
        missing = in_percent(1 - known.nothing)
        return f"No effect can be named; that one is missing has a probability of {missing}."
    sure = f" (probability {in_percent(known.nothing)})" if known else ""
    return f"These trials show nothing that is missing{sure}."


def _better(document: GapDocument) -> list[str]:
    """How much better the written plant is, in the signal with the largest fall in noise floors."""
    result = []
    signal = most_improved_signal(document)
    if signal is not None and document.written.parameters:
        before, after = (errors.held_out[signal] for errors in (document.before, document.after))
        unit = error_unit(before.unit)
        result.append(
            f"The error of {signal_in_words(signal)} falls from {unit.factor * before.rms:.3g} to "
            f"{unit.significant(after.rms)}."
        )
    changes = {
        without_unit(name): q.value / q.before - 1
        for name, q in document.written.parameters.items()
        if q.before and not document.named
    }
    link = [
        f"{name} {change:+.0%}".replace("-", "−")
        for name, change in sorted(changes.items(), key=lambda row: -abs(row[1]))
        if abs(change) >= REPORTED_CHANGE
    ]
    if link:
        result.append(f"The plant is written as refitted: {', '.join(link)}.")
    return result


def _written_otherwise(document: GapDocument) -> list[str]:
    """Strengths that the written plant has with another value than the named one."""
    others = []
    for row in document.named:
        _, strength = strength_of(row)
        named, written = row.parameters[strength], document.written.parameters.get(strength)
        change = max(abs(named.value - named.before), 1e-12)
        if written and abs(written.value - named.value) > OTHER_STRENGTH * change:
            others.append(f"{effect_in_words(row.candidate)} {amount(written)}")
    return [f"The written plant has {', '.join(others)}."] if others else []


def most_improved_signal(document: GapDocument) -> str | None:
    """Signal whose error falls most in noise floors; None if none falls."""
    before, after = document.before.held_out, document.after.held_out
    falls = {
        s: row.floors - new
        for s, row in before.items()
        if row.floors is not None and s in after and (new := after[s].floors) is not None
    }
    signal = max(falls, key=lambda s: falls[s], default=None)
    return signal if signal is not None and falls[signal] > 0 else None


def errors_in_order(document: GapDocument) -> list[tuple[str, SignalGap, SignalGap]]:
    """Signal, error before and after, the signal with the largest gap first."""
    before, after = document.before.held_out, document.after.held_out
    gap = largest_gaps(document.map)
    order = sorted(before, key=lambda s: (-gap.get(s, 0.0), -(before[s].floors or 0.0)))
    return [(s, before[s], after[s]) for s in order if s in after]


def errors_of_what(document: GapDocument) -> str:
    return f"error on {joined(document.held_out.left_out)} left out"


# The trials -------------------------------------------------------------------------------------


def notes_in_words(document: GapDocument) -> list[str]:
    """One sentence for each note on the trials: which were used, and where the plant is known."""
    floor = document.noise_floor
    notes = [
        f"{o.name} ({o.payload_kg:g} kg) is left out: it differs from the plant by {o.floors:.1f} "
        f"noise floors, comparable trials by {o.floors_of_comparable:.1f}."
        for o in document.odd_trials
    ]
    if unused := _listed(document.goal_not_followed_at_row, "{} from row {}"):
        notes.append(f"The current saturates and the joint does not follow, unused: {unused}.")
    if fitted := _listed(document.rows_fitted, "{1} of {0}"):
        notes.append(f"Only the first rows of the longest trials were fitted: {fitted}.")
    if larger := _listed(floor.amplification, "{1:.1f} times at {0} kg"):
        notes.append(
            "Repetitions differ far more than when the plant was identified, so the noise floor is "
            f"larger: {larger}."
        )
    unknown = groups_in_words(key for key, known in floor.own_error.items() if known == "unknown")
    if floor.learned and unknown:
        notes.append(
            "The plant's own error is not known, so effects must be larger to be named; identify "
            f"the plant on trials of this motion too: {unknown}."
        )
    for row in document.changed_conditions:
        here, known = (
            ", ".join(DURATION.text(v) if row.unit == "s" else f"{v:g}" for v in values)
            for values in (row.trials, row.plant)
        )
        notes.append(CHANGED[row.condition].format(here=here, known=known))
    if document.settings.same_link:
        notes.append("The link is taken for the one that the plant was identified on.")
    return notes


def _listed(rows: dict[str, int] | dict[str, float], words: str) -> str:
    return ", ".join(words.format(name, value) for name, value in rows.items())


# What else could explain it, and what to do ------------------------------------------------------


def look_alikes_in_words(row: NamedEffect) -> str:
    """Effects that the trials cannot tell from a named one, and the motion that would."""
    if not row.look_alikes:
        return ""
    sets = [" with ".join(map(effect_in_words, c.effects)) for c in row.look_alikes[:MOST_LISTED]]
    words = f"These trials cannot tell {effect_in_words(row.candidate)} from {joined(sets, 'or')}"
    best = row.separated_by
    if best is None or not best.separation:
        return f"{words}."
    most = max(best.separation.values())
    if most < LEAST_SEPARATION:
        return f"{words}, nor would any motion that was tried."
    return f"{words}; {best.motion} would add most to separate them (d′ {most:.1f})."


def standing_out(document: GapDocument) -> list[RefusedEffects]:
    """Effects that stand out and are not named, unless the named ones explain the gap."""
    if document.verdict == "closed":
        return []
    return [row for row in document.refused if row.kind != "not written"]


def effects_to_check(document: GapDocument) -> dict[str, str]:
    """Check of each effect that is named, may be missing, or looks like a named one.

    An effect that may be missing beside the named ones comes last.
    """
    named = [row.effect for row in document.named]
    likely = [e for e, p in document.effect_probabilities.items() if p > 1 - DECIDED]
    alike = [e for row in document.named for other in row.look_alikes for e in other.effects]
    refused = [e for row in standing_out(document) for e in row.effects]
    order = dict.fromkeys(effect_and_joint(e)[0] for e in (*named, *likely, *alike, *refused))
    return {
        e: EVERY_EFFECT[e].check if e in EVERY_EFFECT else GENERAL_CHECK
        for e in list(order)[:MOST_CHECKS]
    }


def refused_in_words(document: GapDocument) -> list[str]:
    """Effects that stand out and are not named."""
    return [
        f"{joined([effect_in_words(e) for e in row.effects]).capitalize()} "
        f"(d′ {row.separation:.0f}) is not named: {row.reason}."
        for row in standing_out(document)
    ]


def next_step_in_words(document: GapDocument, gap_json: str = "OUT/gap.json") -> str:
    """What to do next; outlier trials come first."""
    step = _next_step(document, gap_json)
    if not document.odd_trials:
        return step
    names = joined([o.name for o in document.odd_trials])
    them = "them" if len(document.odd_trials) > 1 else "it"
    return (
        f"Check payload, conditions and recording of {names} (dropstitch validate), correct or "
        f"repeat {them}, and run gap again. Without {them}: {step}"
    )


def _next_step(document: GapDocument, gap_json: str) -> str:
    """Next step by what the trials show that are not outliers."""
    record = "record another motion or payload, and run gap again"
    known, kinds = document.probabilities, {row.kind for row in document.refused}
    if known is None:
        return "Identify the plant on repeated trials: only repetitions tell noise from error."
    if document.verdict == "not in the catalogue":
        changed = " If the link may have changed since, identify the plant again first."
        return (
            f"{record.capitalize()}, or describe the effect in one file (models/plant/effects)."
            + ("" if document.settings.same_link else changed)
        )
    if not document.named:
        if known.nothing < DECIDED:
            return (
                f"{record.capitalize()}: something may be missing that these trials show too "
                "faintly to be named."
            )
        if document.written.parameters:
            return "Use the refitted plant: train a bundle with it (dropstitch train --plant)."
        return "Nothing: the plant explains these trials."
    undecided = [
        effect_in_words(e)
        for e, p in document.effect_probabilities.items()
        if 1 - DECIDED < p < DECIDED
    ]
    if undecided:
        return (
            f"These trials do not decide on {joined(undecided[:MOST_LISTED])}: 'dropstitch "
            f"experiment --gap {shlex.quote(gap_json)} --config robot.toml --out MOTION.toml' "
            "ranks motions that do."
        )
    if "not written" in kinds:
        return f"Identify the plant again on these trials, or {record}."
    if document.verdict == "reduced":
        return f"The improved plant is the better one, but more than noise is left: {record}."
    return "Use the improved plant: train a bundle with it (dropstitch train --plant)."


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
        Verdict, notes, look-alikes, errors, checks and the next step, one per line.

    Examples
    --------
    With the `diagnosis` in the example of `diagnose`; `Diagnosis.summary` is the short way.

    >>> import dropstitch
    >>> words = dropstitch.gap_in_words(dropstitch.gap_document(diagnosis))
    >>> words.splitlines()[0]
    'verdict: no floor'
    """
    lines = [f"verdict: {document.verdict}", document.headline, document.sentence]
    lines += [f"note: {note}" for note in notes_in_words(document)]
    lines += [words for row in document.named if (words := look_alikes_in_words(row))]
    lines += refused_in_words(document)
    title = f"{errors_of_what(document)}:"
    width = max(len(title), 26) + 2
    lines.append(f"{title:{width}s}{'before':>14s}{'after':>14s}")
    for signal, *errors in errors_in_order(document)[:MOST_LISTED]:
        shown = [error_unit(e.unit).significant(e.rms) for e in errors]
        lines.append(f"{'  ' + signal:{width}s}" + "".join(f"{text:>14s}" for text in shown))
    for effect, check in list(effects_to_check(document).items())[:2]:
        lines.append(f"check on the robot, for {effect.replace('_', ' ')}: {check}")
    lines.append("next: " + next_step_in_words(document, gap_json))
    return "\n".join(lines)
