"""Notes on the trials of a diagnosis: which were used, and what the noise floor covers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from firmware_py.display_units import DURATION
from models.gap.odd_trials import OddTrial
from models.gap.report.changed_conditions import ChangedCondition
from models.gap.report.gap_json import GapDocument
from models.gap.residuals.group_words import groups_in_words

VARIATION_IN_WORDS: Final[Mapping[str, str]] = {
    "eccentricity_m": "place of the payload", "sync_s": "clock", "frame_m": "mocap frame",
}  # fmt: skip
"""Displayed names of kinds of variation between trials; others are shown as they are."""


def notes_in_words(document: GapDocument) -> list[str]:
    """One phrase for each note on the trials."""
    notes = (
        _odd_trials(document), _separate_joints(document), _goal_not_followed(document),
        _nuisance_bias(document), _rows_fitted(document), _own_error(document), _patterns(document),
        _amplification(document), *_changed(document), _link(document), _plant(document),
    )  # fmt: skip
    return [text for text in notes if text]


def _odd_trials(document: GapDocument) -> str:
    """Outlier trials that were left out, and by how much they differ; empty if there are none."""
    rows = "; ".join(
        f"{o.name} ({o.payload_kg:g} kg) differs from {_from_what(o)}" for o in document.odd_trials
    )
    return rows and f"left out: {rows}"


def _from_what(odd: OddTrial) -> str:
    """What an outlier trial differs from, and by how much."""
    if odd.variation:
        return (
            f"its repetition in the {variation_in_words(odd.variation)} by "
            f"{odd.standard_deviations:.0f} standard deviations of what is usual"
        )
    return (
        f"the plant by {odd.floors:.1f} noise floors, comparable trials by "
        f"{odd.floors_of_comparable:.1f}"
    )


def variation_in_words(kind: str) -> str:
    """Kind of variation between trials, with the output that it acts on where it has one."""
    name, _, output = kind.partition(" ")
    along = f" along {output[4]}" if output.startswith("tip_") else ""
    return VARIATION_IN_WORDS.get(name, name) + along


def _separate_joints(document: GapDocument) -> str:
    """Note that each joint has its own strength; empty where one strength was fitted to both."""
    if not document.settings.separate_joints:
        return ""
    return "no effect that is alike in both joints explains the gap: each has its own strength here"


def _goal_not_followed(document: GapDocument) -> str:
    """Rows that were not used, and why; empty where all were."""
    rows = document.goal_not_followed_at_row
    if not rows:
        return ""
    where = ", ".join(f"{name} from row {row}" for name, row in rows.items())
    return f"not used, because the current saturates and the joint does not follow: {where}"


def _nuisance_bias(document: GapDocument) -> str:
    """Variations in which all trials would have to differ in the same way; empty if
    there are none.
    """
    kinds = ", ".join(
        f"{variation_in_words(kind)} by {z:+.0f} standard deviations"
        for kind, z in document.nuisance_bias.items()
    )
    return kinds and f"all trials would have to differ from the usual in the same way: {kinds}"


def _rows_fitted(document: GapDocument) -> str:
    """Trials of which only the first rows were fitted; empty if there are none."""
    rows = ", ".join(f"{count} of {name}" for name, count in document.rows_fitted.items())
    return rows and f"of the longest trials only the first rows were fitted: {rows}"


def _own_error(document: GapDocument) -> str:
    """Trials for which the floor holds no mean error of the plant; empty if it holds all."""
    floor = document.noise_floor
    if not floor.learned:
        return ""
    lacking = [key for key, known in floor.own_error.items() if known.curve == "unknown"]
    where = groups_in_words(lacking)
    return where and (
        "the plant's own error is not known, so not subtracted, and effects must be larger to be "
        f"named: identify the plant on trials of this motion too, for: {where}"
    )


def _patterns(document: GapDocument) -> str:
    """Trials for which the variation of the plant's own error was not measured; empty if there are
    none.

    Only trials with a known mean error are listed; on other motions the patterns are unknown as
    well. For other loads than the link no patterns can be measured.
    """
    floor = document.noise_floor
    known = floor.own_error if floor.learned and "di" in floor.signals else {}
    lacking = [k for k, o in known.items() if o.curve != "unknown" and o.patterns == "unknown"]
    where = groups_in_words(lacking)
    return where and (
        "how the plant's own error varies between links was not measured, so faint effects may be "
        f"missed: run dropstitch calibrate on the trials of the plant, for: {where}"
    )


def _amplification(document: GapDocument) -> str:
    """Payloads whose floor is larger than that of the plant file; empty if there are none."""
    found = document.noise_floor.amplification
    where = ", ".join(f"{factor:.1f} times at {kg} kg" for kg, factor in found.items())
    return where and (
        "repetitions differ far more than when the plant was identified: the noise floor is larger "
        f"there, {where}"
    )


def _link(document: GapDocument) -> str:
    """What is assumed of the link; empty unless it is fixed or a possible change led to
    a refusal.
    """
    if document.settings.same_link:
        return "the link is taken for the one that the plant was identified on, as said"
    refused = {r.effect.replace("_", " ") for r in document.refused if r.kind == "improbable"}
    if not refused or "di" not in document.noise_floor.signals:
        return ""
    return (
        "a link that changed since the plant was identified may look like "
        f"{', '.join(sorted(refused))}: where yours is the same, say --same-link"
    )


def _plant(document: GapDocument) -> str:
    """Note that the plant's values count as known; empty where they are refitted freely."""
    settings = document.settings
    return (
        "the plant was identified on other trials, so its values count as known within "
        f"{settings.known_value_fraction:.0%}: where this is another machine, identify a plant of "
        "it first"
        if settings.plant_is_known
        else ""
    )


def _changed(document: GapDocument) -> list[str]:
    """Conditions of the trials that no trial of the plant has, and their consequence."""
    return [_changed_in_words(row) for row in document.changed_conditions]


def _changed_in_words(row: ChangedCondition) -> str:
    if row.condition == "step_s":
        here, known = (", ".join(map(DURATION.text, own)) for own in (row.trials, row.plant))
        return (
            f"rows are {here} apart, {known} in the trials of the plant: that is right if the "
            "robot sent its goals at this step, wrong if the rows were resampled"
        )
    here, known = (", ".join(f"{v:g}" for v in own) for own in (row.trials, row.plant))
    if row.condition == "payload_kg":
        return (
            f"the plant was identified with {known} kg, not with {here} kg: the noise floor is "
            "larger there, and effects must be larger to be named: identify the plant with these "
            "payloads too"
        )
    return (
        f"the pressure is {here} Pa, {known} Pa in the trials of the plant, whose stiffness holds "
        "there: a change of the link is no missing effect"
    )
