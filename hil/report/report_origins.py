"""Origins of a report's data: notices at its head, table of the inputs, labels of the studies."""

from __future__ import annotations

from collections.abc import Mapping

from hil.report.build_inputs import BuildInputs, LoopRun
from models.shared.pages import Cell, Notice, Table
from models.study.document import StudyDocument
from models.trials.origin import (
    KIND_WORDS,
    TrialOrigin,
    kind_of_origins,
    merged_origins,
    origin_notice,
)

Origins = tuple[TrialOrigin, ...]

EMULATED = Notice(
    "simulated", "Emulated",
    "The loop is the robot's; line and servos are emulated. No robot was run.",
)  # fmt: skip
"""Notice of pages that show only runs of the loop."""


def report_notices(inputs: BuildInputs) -> list[Notice]:
    """Return the notices at the head of a report, on its trials and on its runs of the loop."""
    of_trials = _trial_origins(inputs)
    origins = merged_origins(o for origins in of_trials.values() for o in origins)
    notices = [origin_notice(origins)] if origins else []
    return [*notices, EMULATED] if inputs.loops or inputs.faults else notices


def origin_table(inputs: BuildInputs) -> Table | None:
    """Return a table of the origin of each part's data; None if there is none."""
    rows: list[list[Cell]] = [
        [what, KIND_WORDS[kind_of_origins(origins)], ", ".join(o.counted for o in origins)]
        for what, origins in _trial_origins(inputs).items()
    ]
    rows += [
        [f"Control loop, {loop.name}", KIND_WORDS["simulated"], _behind(loop)]
        for loop in inputs.loops
    ]
    return Table("Where the figures come from", ["", "", "trials"], rows) if rows else None


def study_badges(studies: Mapping[str, StudyDocument]) -> dict[str, str]:
    """Return a label of each study with the kind of its trials, like "1DOF, simulated"."""
    kinds = {name: kind_of_origins(study_origins(study)) for name, study in studies.items()}
    return {name: f"{name}, {KIND_WORDS[kind].lower()}" for name, kind in kinds.items()}


def study_origins(study: StudyDocument) -> Origins:
    """Return the origins of the trials on which a study was trained and tested."""
    parts = (study.training, *study.tests.values())
    return merged_origins(o for part in parts for o in part.origins)


def _trial_origins(inputs: BuildInputs) -> dict[str, Origins]:
    """Origins by the part of the report that shows the trials."""
    found = {f"Study, {name}": study_origins(s) for name, s in inputs.every_study.items()}
    if inputs.plant and inputs.plant.provenance.fitted_trials:
        found["Plant, fitted to"] = inputs.plant.provenance.origins
    for title, evaluation in inputs.evaluations.items():
        found[f"Plant, compared with {title}"] = evaluation.origins
    return found


def _behind(loop: LoopRun) -> str:
    """Text on the plant behind the emulated servos of a run."""
    environment = loop.timing.environment
    return f"emulated servos, the {environment.behind_the_servos} behind them"
