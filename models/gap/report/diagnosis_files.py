"""Files of a diagnosis: gap.json, the improved plant and the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from models.gap.diagnosis import Diagnosis, diagnose
from models.gap.estimation.model_discrepancy import ModelDiscrepancy
from models.gap.odd_trials import without_odd
from models.gap.report.gap_json import DiagnosisInputs, GapDocument, write_gap_document
from models.gap.report.gap_page import write_gap_page
from models.gap.report.gap_results import gap_document
from models.gap.report.waterfall import waterfall_steps
from models.gap.search.effect_search import ReportProgress
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.plant import Plant
from models.trials.trial import TrialSet


def write_diagnosis(
    plant: Plant, trials: TrialSet, inputs: DiagnosisInputs, out: Path,
    report: ReportProgress, leave_out: Sequence[str] = (),
    patterns: Sequence[ModelDiscrepancy] = (), settings: GapSettings = DEFAULT_SETTINGS,
) -> tuple[Diagnosis, GapDocument, Path]:  # fmt: skip
    """Diagnose, and write OUT/gap.json, OUT/plant.json and OUT/report.html.

    Returns the diagnosis, its document, and the path of the page.
    """
    found = diagnose(plant, trials, report, leave_out, settings=settings, patterns=patterns)
    trials = without_odd(trials, found.odd)
    document = gap_document(found, trials, waterfall_steps(found, found.trials))
    document = msgspec.structs.replace(document, inputs=inputs)
    out.mkdir(parents=True, exist_ok=True)
    write_gap_document(out / "gap.json", document)
    found.improved.write(out / "plant.json")
    page = write_gap_page(document, found.plant, found.improved, trials, out / "report.html")
    return found, document, page
