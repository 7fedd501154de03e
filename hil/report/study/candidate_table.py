"""Table of the candidates for the robot's predictor."""

from __future__ import annotations

from collections.abc import Mapping

from firmware_py.core.units import DELAY, FILE_SIZE, FRACTION, LENGTH
from hil.report.study.estimator_figures import test_words
from models.bundle.model_card import latency_text
from models.predictor.document import PredictorsDocument
from models.predictor.validation import COVERS, coverage_text
from models.shared.pages import Table


def candidate_table(documents: Mapping[int, PredictorsDocument]) -> Table:
    """Return errors, coverage and size of every candidate, on held-out rows and on every test."""
    rows = []
    for dof, document in documents.items():
        for name, entry in document.candidates.items():
            chosen = ", chosen" if name == document.chosen else ""
            scores = {"left out in turn": entry.nested}
            scores |= {test_words(test): parts["all"] for test, parts in entry.tests.items()}
            for test, score in scores.items():
                rows.append(
                    [
                        f"{dof}DOF, {name}{chosen}", test,
                        *map(LENGTH.number, (score.mean_m, score.p95_m, score.max_m)),
                        coverage_text(score.coverage, score.coverage_least),
                        FRACTION.text(score.in_range),
                        LENGTH.number(score.max_in_range_m), latency_text(entry.latency),
                        FILE_SIZE.text(entry.graph_bytes),
                    ]
                )  # fmt: skip
    return Table(
        f"Candidates for the robot's predictor, Euclidean distance in {LENGTH.name}",
        ["", "test", "mean", "95th percentile", "maximum", COVERS, "in range",
         "maximum in range", f"warm / cold in {DELAY.name}", "graph"],
        rows,
        " ".join(_note(dof, document) for dof, document in documents.items()),
    )  # fmt: skip


def _note(dof: int, document: PredictorsDocument) -> str:
    """Reason for the choice, and the latency of observer and predictor together by runtime."""
    note = f"{dof}DOF: {document.reason}"
    costs = [
        f"{runtime} {latency_text(latency)} {DELAY.name}"
        for runtime, latency in document.runtimes.items()
    ]
    return (
        f"{note} Observer and predictor together, warm / cold: {', '.join(costs)}."
        if costs
        else note
    )
