"""Notes on the trials of a diagnosis: which were used, and where the plant is known.

A plant is accurate where it was identified; its own error is known only there as well.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final, Literal

from firmware_py.core.units import DURATION
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.transfer import step_of
from models.gap.report.gap_json import ChangedCondition, GapDocument
from models.gap.residuals.localisation import groups_in_words
from models.plant.document import Provenance
from models.trials.trial import Trial

TOLERANCES: Final = {"step_s": 1e-3, "payload_kg": 0.02, "pressure_pa": 0.01}
"""Differences that do not count: of payloads in kg, of the others as a fraction. Rows of a trial
are uniform within the same fraction; pressure varies by 1 % between trials [assumed]."""


def changed_conditions(
    provenance: Provenance, floor: NoiseFloor, trials: Sequence[Trial]
) -> tuple[ChangedCondition, ...]:
    """Conditions that changed since a plant was identified.

    `floor` is that of the plant file. Steps and payloads come from its curves, the pressure from
    the provenance; conditions that these lack are not compared.
    """
    steps_s = {step for key in floor.curves if (step := step_of(key)) is not None}
    payloads_kg = {payload_kg for table in floor.curves.values() for payload_kg in table}
    pressures_pa = {t.pressure_pa for t in provenance.fitted_trials if t.pressure_pa > 0}
    rows = (
        _changed("step_s", "s", steps_s, {t.step_s for t in trials}),
        _changed("payload_kg", "kg", payloads_kg, {t.meta.payload_kg for t in trials}),
        _changed("pressure_pa", "Pa", pressures_pa, {t.meta.pressure_pa for t in trials}),
    )
    return tuple(row for row in rows if row.plant and row.trials)


def _changed(
    condition: Literal["step_s", "payload_kg", "pressure_pa"],
    unit: str,
    plant: Collection[float],
    trials: Collection[float],
) -> ChangedCondition:
    def is_known(value: float) -> bool:
        limit = TOLERANCES[condition] * (1.0 if condition == "payload_kg" else value)
        return any(abs(value - other) <= limit for other in plant)

    other = sorted(v for v in trials if not is_known(v))
    return ChangedCondition(condition, unit, tuple(sorted(plant)), tuple(other))


def notes_in_words(document: GapDocument) -> list[str]:
    """One sentence for each note on the trials."""
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
    notes += _own_error(document)
    notes += [_changed_in_words(row) for row in document.changed_conditions]
    if document.settings.same_link:
        notes.append("The link is taken for the one that the plant was identified on.")
    return notes


def _listed(rows: dict[str, int] | dict[str, float], words: str) -> str:
    return ", ".join(words.format(name, value) for name, value in rows.items())


def _own_error(document: GapDocument) -> list[str]:
    """Trials for which the plant's own error is not known."""
    floor = document.noise_floor
    unknown = (key for key, known in floor.own_error.items() if known == "unknown")
    if not floor.learned or not (where := groups_in_words(unknown)):
        return []
    return [
        "The plant's own error is not known, so effects must be larger to be named; identify "
        f"the plant on trials of this motion too: {where}."
    ]


def _changed_in_words(row: ChangedCondition) -> str:
    """What differs from the trials of the plant, and its consequence."""
    if row.condition == "step_s":
        here, known = (
            ", ".join(map(DURATION.text, steps_s)) for steps_s in (row.trials, row.plant)
        )
        return (
            f"Rows are {here} apart, {known} in the trials of the plant: right if the robot sent "
            "its goals at this step, wrong if the rows were resampled."
        )
    here, known = (", ".join(f"{v:g}" for v in values) for values in (row.trials, row.plant))
    if row.condition == "payload_kg":
        return (
            f"The plant was identified with {known} kg, not with {here} kg, so effects must be "
            "larger to be named there; identify it with these payloads too."
        )
    return (
        f"The pressure is {here} Pa, {known} Pa in the trials of the plant: a change of the link "
        "is no missing effect."
    )
