"""Timing document (`timing.json`): verdict on a run, its tick budget and prediction error.

Times are in ns, distances in m.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import msgspec

from firmware_py.core.documents import read_document, write_document
from firmware_py.core.units import DisplayUnit
from firmware_py.summary import FeedbackUse, RangeReasons
from firmware_py.system.timing import LABELS, Percentiles
from hil.sil.probe import ReferenceJitter
from hil.sil.processors import HostEnvironment
from hil.sil.tick_budget import PlanTimes
from hil.sil.timing_verdict import TimingVerdict


class SilEnvironment(HostEnvironment, frozen=True, kw_only=True, omit_defaults=True):
    """Machine, line and scheduler of a run in software."""

    line: str  # Kind of line: "pty", "socket" or "virtual"
    baud: int  # Bits per second
    latency_timer_ns: int  # Latency timer of the emulated USB adapter
    servo: str  # Servo model
    payload_kg: float  # Payload at the tip
    behind_the_servos: str  # Simulated plant: "twin" or "rig"
    scheduler: str  # Scheduling policy and priority of the loop
    # Rate of each kind of line fault
    faults: dict[str, float] = msgspec.field(default_factory=dict)
    # Strength of each effect that was added to the rig
    hidden: dict[str, float] = msgspec.field(default_factory=dict)
    # Warning that the plan or the map was computed with another plant than the bundle's; or empty
    goals_note: str = ""
    # Real-time rights that the kernel refused, on a line in real time
    refused: tuple[str, ...] = ()
    loop_processor: int | None = None  # Processor of the loop, on a line in real time
    line_processor: int | None = None  # Processor of the emulator, on a line in real time
    load_processes: int = 0  # Number of processes of the declared host load
    load_is: str | None = None  # Description of the declared host load
    # Ratio of simulated time to wall-clock time, on the virtual line
    speed_up: float | None = None
    # Ratio of simulated time to processor time, on the virtual line
    speed_up_by_processor_time: float | None = None
    records_sha256: str | None = None  # Hash of ticks and true tip, on the virtual line


class RunFacts(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Course of a run."""

    ended: str  # How the run ended, see `firmware_py.summary.Ended`
    reason: str  # Why the run ended
    wall_s: float  # Wall-clock duration
    bus_faults: dict[str, int]  # Number of ticks by status of the bus, if not OK
    faults_injected: dict[str, int]  # Number of injected line faults by kind
    telemetry_drops: int  # Ticks that did not reach the recorder
    # Durations of the parts that the run repeats: rest, motion, glide
    programme_s: dict[str, float]
    feedback: FeedbackUse  # How often feedback of the tip acted
    # Warning that the estimated payload is outside the plan's payloads; or empty
    payload_note: str
    out_of_range: int = 0  # Ticks out of the predictor's range
    out_of_range_reasons: RangeReasons = RangeReasons()  # Why


class TipErrors(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Distance between the predicted and the true tip over some ticks."""

    n: int  # Number of ticks with fresh data; without any, the other fields are null
    mean_euclidean_distance_m: float | None
    rms_m: float | None
    p95_m: float | None  # 95th percentile
    max_m: float | None
    # Fraction of ticks inside the predictor's 95 % interval, mean over the axes that move
    interval_coverage: float | None
    interval_coverage_least: float | None  # The same fraction on the worst of these axes
    in_range_fraction: float | None  # Fraction of ticks inside the predictor's training range


class PredictionError(TipErrors, frozen=True, kw_only=True):
    """Distance between the predicted and the true tip over a run, and over its parts."""

    # Errors of each part that has fresh ticks: in_range, out_of_range, approach, the parts of the
    # programme, stop
    parts: dict[str, TipErrors] = msgspec.field(default_factory=dict)


class PathError(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Distance of the tip from its path in one run of a plan, in the planned coordinates."""

    rms_m: float  # RMS over the whole run, including rest, approach and return
    max_m: float  # Maximum over the whole run
    path_rms_m: float  # RMS over the path alone
    rows: int  # Number of ticks that count: with fresh data, and before a stop


class MoveFigures(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Move of a plan from rest to rest, in the planned coordinates."""

    # Time from the start of the move until the tip stays within 10 mm of its rest position
    settling_s: float
    # Residual vibration: half of the largest range of a coordinate after the end of the command
    swing_m: float
    offset_m: float  # Distance of the rest position from the desired one
    command_s: float  # Duration of the commanded move, without the rest after it


class TimingDocument(TimingVerdict, frozen=True, kw_only=True):
    """Contents of `timing.json`: the verdict and the measurements behind it."""

    MADE_BY: ClassVar[str] = "dropstitch sil"

    environment: SilEnvironment  # Machine, line and scheduler
    run: RunFacts  # Course of the run
    reference_jitter: ReferenceJitter  # Wake-up jitter of the machine
    bus_plan: PlanTimes  # Times that follow from the bus plan
    read_parts: dict[str, Percentiles]  # Parts of the read: own, transmission, servo, wait
    prediction_error: PredictionError  # Error of the robot's prediction
    # Path error in each complete run of a plan
    path_errors: tuple[PathError, ...] = ()
    moves: tuple[MoveFigures, ...] = ()  # Moves from rest to rest in the last run of a plan


def read_timing(path: Path) -> TimingDocument:
    return read_document(path, TimingDocument)


def write_timing(path: Path, document: TimingDocument) -> None:
    write_document(path, document)


def duration_table(timing: TimingDocument, unit: DisplayUnit) -> list[list[str]]:
    """Return the durations of the stages, of the whole tick and of the wake-up, header first."""
    rows: dict[str, tuple[Percentiles, str]] = {}
    for name, stage in timing.stages.items():
        budget = unit.number(stage.budget_p99_ns)
        rows[f"stage: {name}"] = stage, "" if name == "read" else budget
        if name == "read":  # its budget is that of its own part
            for part, durations in timing.read_parts.items():
                rows[f"read: {part}"] = durations, budget if part == "own" else ""
    rows |= {
        "slack": (timing.slack, f"least {unit.number(timing.slack.min_ns)}"),
        "whole tick": (timing.tick, ""),
        "waiting for the bus": (timing.bus_wait, ""),
        "own cost": (timing.own_cost, ""),
        "preempted by the host": (timing.host, ""),
        "wake-up latency": (timing.lateness, ""),
        "wake-up latency of the reference": (timing.reference_jitter, ""),
    }
    return [["", "n", *LABELS, "budget of p99"]] + [
        [name, str(row.n), *(unit.number(getattr(row, field)) for field in LABELS.values()), note]
        for name, (row, note) in rows.items()
    ]
