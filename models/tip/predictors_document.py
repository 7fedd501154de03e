"""Predictors document (`predictors.json`): the candidates for the robot's tip predictor compared.

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
    mean_m: float  # Euclidean distance: mean, 95 % quantile, largest
    p95_m: float
    max_m: float
    coverage: float  # Fraction of rows inside the 95 % interval, mean over the axes that move
    half_width_m: float  # Mean half width over rows and axes
    in_range: float  # Fraction of rows in range
    max_in_range_m: float  # Largest distance among these
    coverage_least: float  # Coverage on the worst of these axes


class Latency(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Median duration of a call on the machine that made the bundle."""

    warm_s: float  # In a hot loop
    cold_s: float  # With a control period before each call, as in the robot's loop


class CandidateEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Candidate."""

    summary: str
    variant: int  # Variant chosen on all training rows, like the degree
    nested: TipScore  # Nested cross-validation: payloads and motions left out
    # Trials that nothing was trained on: "all" rows, "rest", "motion". "stiffness_x_0.8" and the
    # like are all of them with an observer whose plant is wrong.
    tests: dict[Test, dict[Part, TipScore]]
    graph_bytes: int  # Size of its ONNX graph
    latency: Latency  # Of its graph in onnxruntime


class PredictorsDocument(Document, frozen=True, kw_only=True):
    """Content of `predictors.json`."""

    VERSION: ClassVar[int] = 1
    MADE_BY: ClassVar[str] = "python -m models train"

    dof: Annotated[int, msgspec.Meta(ge=1, le=2)]
    chosen: str  # Candidate that the robot gets
    reason: str  # Why, in one sentence
    trials: tuple[str, ...]
    motions: tuple[str, ...]
    payload_kg: tuple[float, ...]
    # In the order in which they were compared, simplest first
    candidates: dict[str, CandidateEntry]
    askew_rad: float  # Angle by which the link may be mounted askew, which the interval covers
    # Observer and predictor together, by runtime; added with the observer
    runtimes: dict[str, Latency] = msgspec.field(default_factory=dict)


def read_predictors(path: Path) -> PredictorsDocument:
    """Read `predictors.json`."""
    return read_document(path, PredictorsDocument)


def write_predictors(path: Path, document: PredictorsDocument) -> None:
    """Write `predictors.json`."""
    write_document(path, document)
