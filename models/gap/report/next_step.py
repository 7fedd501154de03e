"""Next step after a diagnosis, in words."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Final

from models.gap.decision.posterior import DECIDED
from models.gap.report.effect_checks import EFFECT_CHECKS, further_missing
from models.gap.report.gap_json import GapDocument, SeparatingMotion
from models.gap.report.trial_notes import variation_in_words
from models.gap.settings import GapSettings

SHOWS_AS: Final[Mapping[str, str]] = {
    "friction": "coulomb_friction", "pressure": "pressure_leak", "eccentricity_m": "payload_offset",
    "frame_m": "marker_frame_tilt",
}  # fmt: skip
"""Effect whose check reveals a variation that all trials share, by
`GapSettings.nuisance_bias_kinds`."""


def next_step_in_words(document: GapDocument, gap_json: str = "OUT/gap.json") -> str:
    """What to do next, in one sentence; outlier trials come first."""
    if not document.odd_trials:
        return _next_step_of_the_rest(document, gap_json)
    names = ", ".join(o.name for o in document.odd_trials)
    return (
        f"Check payload_kg, conditions and recording of {names} (dropstitch validate), mend "
        f"or repeat it, and run gap again. Without it: {_next_step_of_the_rest(document, gap_json)}"
    )


def _next_step_of_the_rest(document: GapDocument, gap_json: str) -> str:
    """Next step by what the remaining trials show."""
    if document.verdict == "no floor":
        return "Repeat at least one trial: only repetitions tell noise from error."
    if document.verdict == "not in the catalogue":
        return _next_step_outside(document)
    if not any(row.kept for row in document.named):
        return _next_step_without_a_name(document)
    undecided = [
        effect.replace("_", " ")
        for effect, probability in document.effect_probabilities.items()
        if 1 - DECIDED < probability < DECIDED
    ]
    if undecided:
        two = any("_2_" in signal for signal in document.before["fitted"])
        return (
            f"These trials do not decide on {', '.join(undecided)}: 'dropstitch experiment "
            f"--gap {shlex.quote(gap_json)} --config robot.toml --out MOTION.toml' designs the "
            f"motion that tells best{', for a robot.toml with both servos' if two else ''}."
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
    if document.verdict == "reduced":
        return _next_step_of_more(document)
    return "Use the improved plant: train a bundle with it (dropstitch train --plant)."


def _next_step_of_more(document: GapDocument) -> str:
    """Next step where more than noise remains with the named effects."""
    record = "record another motion or payload and run gap again before you train with it."
    if document.nuisance_bias:
        kind = max(document.nuisance_bias, key=lambda own: abs(document.nuisance_bias[own]))
        check = EFFECT_CHECKS[SHOWS_AS[kind.split()[0]]]
        return (
            "The improved plant is the better one, but all trials differ from the plant alike in "
            f"their {variation_in_words(kind)}. {check} Or {record}"
        )
    further = further_missing(document)
    if further is None:
        return f"The improved plant is the better one, but more than noise is left: {record}"
    effect = further.effect.replace("_", " ")
    check = EFFECT_CHECKS.get(further.effect, "")
    return (
        f"The improved plant is the better one, but these trials do not decide whether {effect} is "
        f"missing too.{check and f' {check}'} Or {record}"
    )


def _next_step_without_a_name(document: GapDocument) -> str:
    """Next step where no effect is named, and nothing outside of the catalogue is probable."""
    answers = document.answers
    if answers is None or answers.nothing >= DECIDED:
        if document.refitted:
            return "Use the refitted plant: train a bundle with it (dropstitch train)."
        return "Nothing: the plant explains these trials."
    refitted = "plant.json holds the refitted link, the better plant so far. "
    return (
        f"{refitted if document.refitted else ''}Record another motion or payload, or more "
        f"repetitions: with a probability of {in_percent(1 - answers.nothing)} something is "
        "missing that these trials show too faintly to be named."
    )


def _next_step_outside(document: GapDocument) -> str:
    """Next step where something outside of the catalogue is more probable than nothing."""
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


def is_plant_as_given(document: GapDocument) -> bool:
    """Whether the plant that was written equals the plant that was diagnosed."""
    named = {e for row in document.named if row.kept for e in row.effect.split(" + ")}
    return not (document.refitted or named - _withheld(document))


def _withheld(document: GapDocument) -> set[str]:
    rows = [row for row in document.refused if row.kind == "not written"]
    return {effect for row in rows for effect in row.effect.split(" + ")}


def separated_in_words(separated_by: SeparatingMotion | None, settings: GapSettings) -> str:
    """Which fixed motion tells an effect from its look-alikes, if any does."""
    largest = max(separated_by.separation.values(), default=0.0) if separated_by else 0.0
    if separated_by is None or largest < settings.indistinguishable_separation:
        return "no fixed motion tells them apart, a designed one may (dropstitch experiment)"
    return f"the motion '{separated_by.motion}' tells them apart (d′ {largest:.1f})"


def in_percent(probability: float) -> str:
    """Probability in per cent, never 0 or 100 %: no finite number of trials proves either."""
    return "<1%" if probability < 0.01 else f"{min(probability, 0.99):.0%}"
