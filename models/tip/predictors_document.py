"""Predictors document (`predictors.json`): comparison of candidates for the robot's tip predictor.

Distances and widths are in m; coverage and fractions are dimensionless.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

import msgspec

from firmware_py.documents import Document, read_document, write_document

__all__ = ["CandidateEntry", "Latency", "PredictorsDocument", "TipScore", "read_predictors"]

Test = str
Part = str


class TipScore(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Errors of a predictor on some rows."""

    rows: int
    mean_m: float  # Mean Euclidean distance of predicted and measured tip
    p95_m: float  # 95 % quantile of this distance
    max_m: float  # Largest distance
    coverage: float  # Fraction of rows inside the 95 % interval, mean over the axes that move
    half_width_m: float  # Mean half width over rows and axes
    in_range: float  # Fraction of rows in range
    max_in_range_m: float  # Largest distance among the rows in range
    coverage_least: float  # Coverage on the worst of the axes that move


class Latency(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Median duration of a call on the machine that made the bundle."""

    warm_s: float  # In a hot loop
    cold_s: float  # With a control period before each call, as in the robot's loop


class CandidateEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Candidate with its scores."""

    summary: str
    variant: int  # Variant, for example a degree, chosen on all training rows
    nested: TipScore  # Score in nested cross-validation: payloads and motions left out
    # Scores on trials that nothing was trained on: "all" rows, "rest", "motion". The test
    # "stiffness_x_0.8" and similar ones are all these trials with an observer whose plant is wrong
    tests: dict[Test, dict[Part, TipScore]]
    graph_bytes: int  # Size of its ONNX graph
    latency: Latency  # Latency of its graph in onnxruntime


class PredictorsDocument(Document, frozen=True, kw_only=True):
    """Content of `predictors.json`."""

    VERSION: ClassVar[int] = 1
    MADE_BY: ClassVar[str] = "dropstitch train"

    dof: Annotated[int, msgspec.Meta(ge=1, le=2)]
    chosen: str  # Candidate that the robot gets
    reason: str  # Reason for the choice, in one sentence
    trials: tuple[str, ...]
    motions: tuple[str, ...]
    payload_kg: tuple[float, ...]
    candidates: dict[str, CandidateEntry]  # Candidates in the order of comparison, simplest first
    askew_rad: float  # Angle by which the link may be mounted askew, which the interval covers
    # Observer and predictor together, by runtime; added with the observer
    runtimes: dict[str, Latency] = msgspec.field(default_factory=dict)


def read_predictors(path: Path) -> PredictorsDocument:
    return read_document(path, PredictorsDocument)


def write_predictors(path: Path, document: PredictorsDocument) -> None:
    write_document(path, document)
