"""Predictors document (`predictors.json`): the robot's tip predictor and what it was compared with.

Distances and widths are in m; coverage and fractions are dimensionless.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Final

import msgspec
import numpy as np

from firmware_py.core.documents import Document, read_document, write_document
from firmware_py.core.input_files import FileContent
from firmware_py.core.signals import PERIOD_S
from firmware_py.core.units import DELAY
from firmware_py.inference.predictor import OnnxGraph
from firmware_py.summary import RangeReasons
from models.predictor.onnx_graphs import OUTPUTS
from models.trials.origin import TrialOrigin, origins_of
from models.trials.trial import Trial, TrialSet

Test = str
Part = str


class TrialsSummary(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Set of trials that something was trained or tested on."""

    trials: tuple[str, ...]
    sha256: str  # Hash of their content
    payload_kg: tuple[float, ...]  # Values that occur, ascending
    amplitude_rad: tuple[float, ...]
    phase_2_rad: tuple[float, ...]
    step_s: Annotated[float, msgspec.Meta(ge=1e-3, le=1.0)]
    origins: tuple[TrialOrigin, ...]  # Whether the trials were simulated or measured


def summary_of(trials: Sequence[Trial]) -> TrialsSummary:
    trials = TrialSet(tuple(trials))

    def values(name: str) -> tuple[float, ...]:
        return tuple(sorted({getattr(t.meta, name) for t in trials}))

    return TrialsSummary(
        trials=tuple(t.name for t in trials),
        sha256=trials.sha256(),
        payload_kg=values("payload_kg"),
        amplitude_rad=values("amplitude_rad"),
        phase_2_rad=values("phase_2_rad"),
        step_s=round(trials[0].step_s, 9),
        origins=origins_of(trials),
    )


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


def latency_text(latency: Latency) -> str:
    """Latency as "warm / cold" in µs."""
    return f"{DELAY.number(latency.warm_s)} / {DELAY.number(latency.cold_s)}"


def scores_of(entry: CandidateEntry) -> Iterable[tuple[str, TipScore]]:
    """Scores of a candidate: in nested cross-validation, and on all rows of each test."""
    yield "left out in turn", entry.nested
    yield from ((test, parts["all"]) for test, parts in entry.tests.items())


class PredictorsDocument(Document, frozen=True, kw_only=True):
    """Content of `predictors.json`."""

    VERSION: ClassVar[int] = 1
    MADE_BY: ClassVar[str] = "dropstitch train"

    dof: Annotated[int, msgspec.Meta(ge=1, le=2)]
    chosen: str  # Candidate that the robot gets
    reason: str  # Chosen candidate with its errors, in words
    trials: tuple[str, ...]
    motions: tuple[str, ...]
    payload_kg: tuple[float, ...]
    candidates: dict[str, CandidateEntry]  # Candidates in the order of comparison, simplest first
    askew_rad: float  # Angle by which the link may be mounted askew, which the interval covers
    # Trials that it was trained on, "training", and those of each test
    data: dict[str, TrialsSummary] = msgspec.field(default_factory=dict)
    # Why rows of each test were out of range with the chosen candidate; a tick is a row
    out_of_range: dict[Test, RangeReasons] = msgspec.field(default_factory=dict)
    # Observer and predictor together, by runtime; added with the observer
    runtimes: dict[str, Latency] = msgspec.field(default_factory=dict)


def read_predictors(path: Path) -> PredictorsDocument:
    return read_document(path, PredictorsDocument)


def write_predictors(path: Path, document: PredictorsDocument) -> None:
    write_document(path, document)


WARM_CALLS: Final = 200
COLD_CALLS: Final = 25
"""Calls of which the median is taken; a cold one waits for a control period first."""


def measure_latency(call: Callable[[], object]) -> Latency:
    """Median duration of a call in a hot loop, and with a control period before each call."""
    medians_s = []
    for count, pause_s in ((WARM_CALLS, 0.0), (COLD_CALLS, PERIOD_S)):
        taken_ns = []
        for _ in range(count):
            if pause_s:
                time.sleep(pause_s)
            start_ns = time.perf_counter_ns()
            call()
            taken_ns.append(time.perf_counter_ns() - start_ns)
        medians_s.append(float(np.median(taken_ns)) * 1e-9)
    return Latency(*medians_s)


def graph_latency(data: bytes) -> Latency:
    """Latency of a predictor's graph in onnxruntime."""
    graph = OnnxGraph(FileContent(Path("graph"), data), None, tuple(OUTPUTS.items()))
    return measure_latency(graph.run)
