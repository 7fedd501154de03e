"""Files of a diagnosis: gap.json, the improved plant and the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from models.gap.diagnosis import Diagnosis, diagnose
from models.gap.report.gap_json import DiagnosisInputs, GapDocument, write_gap_document
from models.gap.report.gap_page import write_gap_page
from models.gap.report.gap_results import gap_document
from models.gap.search.effect_search import ReportProgress
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.plant import Plant
from models.trials.trial import TrialSet


def write_diagnosis(
    plant: Plant, trials: TrialSet, inputs: DiagnosisInputs, out: Path,
    report: ReportProgress, leave_out: Sequence[str] = (),
    settings: GapSettings = DEFAULT_SETTINGS,
) -> tuple[Diagnosis, GapDocument, Path]:  # fmt: skip
    """Diagnose, and write OUT/gap.json, OUT/plant.json and OUT/report.html.

    Returns the diagnosis, its document, and the path of the page.
    """
    diagnosis = diagnose(plant, trials, report, leave_out, settings=settings)
    return diagnosis, *write_results(diagnosis, inputs, out)


def write_results(
    diagnosis: Diagnosis, inputs: DiagnosisInputs, out: Path
) -> tuple[GapDocument, Path]:
    """Write the files of a diagnosis; returns its document and the path of the page."""
    document = msgspec.structs.replace(gap_document(diagnosis), inputs=inputs)
    out.mkdir(parents=True, exist_ok=True)
    write_gap_document(out / "gap.json", document)
    diagnosis.improved.write(out / "plant.json")
    page = out / "report.html"
    write_gap_page(document, diagnosis.plant, diagnosis.improved, diagnosis.trials, page)
    return document, page
