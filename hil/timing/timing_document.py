"""Timing document (`timing.json`): the verdict on a run, its tick budget and prediction error.

Times are in ns, distances in m.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import msgspec

from firmware_py.documents import read_document, write_document
from firmware_py.summary import FeedbackUse
from hil.timing.processors import HostEnvironment
from hil.timing.reference_jitter import ReferenceJitter
from hil.timing.tick_budget import PlanTimes, TickBudget
from hil.timing.timing_verdict import TimingVerdict

__all__ = ["TimingDocument", "read_timing", "write_timing"]


class SilEnvironment(HostEnvironment, frozen=True, kw_only=True, omit_defaults=True):
    """Machine, line and scheduler of a run in software."""

    line: str  # "pty", "socket" or "virtual"
    baud: int
    latency_timer_ns: int  # Of the emulated USB adapter
    servo: str
    payload_kg: float
    behind_the_servos: str
    scheduler: str  # Policy and priority of the loop
    faults: dict[str, float] = msgspec.field(default_factory=dict)  # Rates of the line's faults
    hidden: dict[str, float] = msgspec.field(default_factory=dict)  # Effects hidden in the rig
    # Sentence on a plan or a map that was made with another plant than the bundle
    goals_note: str = ""
    # Real-time rights that the kernel refused, on a line in real time
    refused: tuple[str, ...] = ()
    loop_processor: int | None = None  # Processors of loop and emulator, on a line in real time
    line_processor: int | None = None
    load_processes: int = 0  # Processes of the declared host load
    load_is: str | None = None
    # Simulated time against the wall clock and against processor time, on the virtual line
    speed_up: float | None = None
    speed_up_by_processor_time: float | None = None
    records_sha256: str | None = None  # Hash of ticks and true tip, on the virtual line


class RunFacts(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Course of a run."""

    ended: str  # How it ended, see `firmware_py.summary.Ended`, and one sentence
    reason: str
    wall_s: float  # Duration by the wall clock
    bus_faults: dict[str, int]  # Ticks by status of the bus
    faults_injected: dict[str, int]  # Faults of the line by kind
    telemetry_drops: int  # Ticks that the recorder did not get
    # Durations of the parts that the run repeats: rest, motion, glide
    programme_s: dict[str, float]
    feedback: FeedbackUse  # How often feedback of the tip acted
    # Sentence where the estimated payload is beyond those of the plan; else empty
    payload_note: str


class TipErrors(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Distance between the predicted and the true tip over some ticks."""

    n: int  # Ticks with fresh data; the other fields are None where there is none
    mean_euclidean_distance_m: float | None
    rms_m: float | None
    p95_m: float | None
    max_m: float | None
    # Fraction of ticks inside the predictor's 95 % interval, mean over the axes that move
    interval_coverage: float | None
    interval_coverage_least: float | None  # The same on the worst of these axes
    in_range_fraction: float | None  # Fraction of ticks inside the predictor's training range


class PredictionError(TipErrors, frozen=True, kw_only=True):
    """Distance between the predicted and the true tip over a run, and over its parts."""

    # In_range, out_of_range and the parts of the programme, where they have fresh ticks
    parts: dict[str, TipErrors] = msgspec.field(default_factory=dict)


class PathError(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Distance of the tip from its path in one run of a plan, in the planned coordinates."""

    rms_m: float  # Over the whole run, rest and ways included
    max_m: float
    path_rms_m: float  # Over the path alone
    rows: int  # Ticks that count: fresh, and not of a stop


class MoveFigures(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Move of a plan from rest to rest, in the planned coordinates."""

    # Time from its start until the tip stays within 10 mm of where it comes to rest
    settling_s: float
    swing_m: float  # Half of the largest range of a coordinate after the move itself is over
    offset_m: float  # Distance of the place of rest from the desired one
    command_s: float  # Duration of the move itself: of the path, for comparisons of the goals


class TimingDocument(TimingVerdict, frozen=True, kw_only=True):
    """Contents of `timing.json`: the verdict, and what it was reached on."""

    MADE_BY: ClassVar[str] = "python -m hil sil"

    environment: SilEnvironment  # Machine, line and scheduler
    run: RunFacts
    # Wake-up jitter of the machine, by cyclictest where it is installed, else by the probe
    reference_jitter: ReferenceJitter
    probe_jitter: ReferenceJitter | None = None  # The probe's, where cyclictest gave the reference
    bus_plan: PlanTimes
    account: TickBudget  # Time of the ticks, by where it went
    prediction_error: PredictionError  # Error of the robot's prediction
    # Where a plan was run: error of the tip in each of its runs
    path_errors: tuple[PathError, ...] = ()
    moves: tuple[MoveFigures, ...] = ()  # Moves from rest to rest in the last run of a plan


def read_timing(path: Path) -> TimingDocument:
    return read_document(path, TimingDocument)


def write_timing(path: Path, document: TimingDocument) -> None:
    write_document(path, document)
