"""Conditions in which the trials of a diagnosis differ from those that the plant was identified on.

A plant is accurate where it was identified; its own error is known only there as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, Literal

import msgspec

from models.gap.estimation.curve_transfer import step_of
from models.gap.estimation.noise_floor import NoiseFloor
from models.plant.document import Provenance
from models.trials.trial import Trial

Condition = Literal["step_s", "payload_kg", "pressure_pa"]

TOLERANCES: Final[dict[Condition, float]] = {
    "step_s": 1e-3,
    "payload_kg": 0.02,
    "pressure_pa": 0.01,
}
"""Differences that do not count: of payloads in kg, of the others as a fraction. Rows of a trial
are uniform within the same fraction; pressure varies by 1 % between trials [assumed]."""

UNITS: Final[dict[Condition, str]] = {"step_s": "s", "payload_kg": "kg", "pressure_pa": "Pa"}


class ChangedCondition(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Condition with values that no trial of the plant has."""

    condition: Condition  # Step (time between two rows), payload, or pressure
    unit: str
    plant: tuple[float, ...]  # Values in the trials of the plant
    trials: tuple[float, ...]  # Values in the diagnosed trials that no trial of the plant has


def changed_conditions(
    provenance: Provenance, floor: NoiseFloor, trials: Sequence[Trial]
) -> tuple[ChangedCondition, ...]:
    """Conditions that changed since a plant was identified.

    `floor` is that of the plant file. Steps and payloads come from its curves, the pressure from
    the provenance; conditions that these lack are not compared.
    """
    known: dict[Condition, set[float]] = {
        "step_s": {step for key in floor.curves if (step := step_of(key)) is not None},
        "payload_kg": {payload_kg for table in floor.curves.values() for payload_kg in table},
        "pressure_pa": {t.pressure_pa for t in provenance.fitted_trials if t.pressure_pa > 0},
    }
    here: dict[Condition, set[float]] = {
        "step_s": {t.step_s for t in trials},
        "payload_kg": {t.meta.payload_kg for t in trials},
        "pressure_pa": {t.meta.pressure_pa for t in trials},
    }
    rows = []
    for condition, unit in UNITS.items():
        plant = tuple(sorted(known[condition]))
        other = tuple(v for v in sorted(here[condition]) if not _is_among(v, plant, condition))
        if plant and other:
            rows.append(ChangedCondition(condition, unit, plant, other))
    return tuple(rows)


def _is_among(value: float, known: Iterable[float], condition: Condition) -> bool:
    limit = TOLERANCES[condition] * (1.0 if condition == "payload_kg" else value)
    return any(abs(value - other) <= limit for other in known)
