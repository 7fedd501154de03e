"""Record of the conditions under which the rig ran each trial of a directory.

The record lies beside the trials. Only `refuse_other_conditions` reads it, so that hidden effects
stay out of the trials themselves; pages read the name of the rig (`models.trials.trial_origin`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Final

import msgspec

from firmware_py.documents import Document, read_document, write_document
from firmware_py.errors import InputError
from models.rig.rig_structure import RigStructure
from models.rig.trial_case import TrialCase

CONDITIONS_FILE: Final = "rig_conditions.json"


class RigConditions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Conditions of a trial that its own files do not contain."""

    seed: int  # Seed of variation and noise
    hidden: dict[str, float]  # Strength of each hidden effect, in its unit
    rig_sha256: str  # Hash of the rig's structure and parameters, hidden effects included
    rig: str  # Name of the rig, or its file
    structure: RigStructure  # Forms of the rig's equations


class ConditionsRecord(Document, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Conditions of simulated trials."""

    MADE_BY: ClassVar[str] = "dropstitch simulate"

    trials: dict[str, RigConditions]  # Conditions by name of the trial


def refuse_other_conditions(
    cases: Sequence[TrialCase], conditions: RigConditions, directory: Path
) -> None:
    """Refuse to overwrite a trial that was measured or simulated under other conditions."""
    recorded = _read_trials(directory)
    for case in cases:
        path = directory / f"{case.name}.csv"
        if path.exists() and recorded.get(case.name) != conditions:
            raise InputError(
                path,
                "holds a trial that was run under other conditions",
                "choose another --out, or remove it",
            )


def record_conditions(
    cases: Sequence[TrialCase], conditions: RigConditions, directory: Path
) -> None:
    """Add the conditions of these trials to the directory's record, before they are simulated."""
    directory.mkdir(parents=True, exist_ok=True)
    trials = _read_trials(directory) | {case.name: conditions for case in cases}
    record = ConditionsRecord(schema=ConditionsRecord.VERSION, trials=dict(sorted(trials.items())))
    write_document(directory / CONDITIONS_FILE, record)


def _read_trials(directory: Path) -> dict[str, RigConditions]:
    path = directory / CONDITIONS_FILE
    return read_document(path, ConditionsRecord).trials if path.exists() else {}
