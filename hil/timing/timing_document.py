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
    """Machine, line and scheduler of a run in software.

    Attributes
    ----------
    line : str
        "pty", "socket" or "virtual".
    baud : int
        Bits per second.
    latency_timer_ns : int
        Of the emulated USB adapter.
    servo : str
        Model of the servos.
    faults : dict of str to float
        Rates of the line's faults.
    payload_kg : float
        At the tip.
    behind_the_servos : str
        "twin" or "rig".
    hidden : dict of str to float
        Effects hidden in the rig.
    scheduler : str
        Policy and priority of the loop.
    goals_note : str
        Sentence on a plan or a map that was made with another plant than the bundle.
    refused : tuple of str
        Real-time rights that the kernel refused, on a line in real time.
    loop_processor, line_processor : int or None
        Processors of loop and emulator, on a line in real time.
    load_processes : int
        Processes of the declared host load.
    load_is : str or None
        Description of that load.
    speed_up, speed_up_by_processor_time : float or None
        Simulated time against the wall clock and against processor time, on the virtual line.
    records_sha256 : str or None
        Hash of ticks and true tip, on the virtual line.
    """

    line: str
    baud: int
    latency_timer_ns: int
    servo: str
    payload_kg: float
    behind_the_servos: str
    scheduler: str
    faults: dict[str, float] = msgspec.field(default_factory=dict)
    hidden: dict[str, float] = msgspec.field(default_factory=dict)
    goals_note: str = ""
    refused: tuple[str, ...] = ()
    loop_processor: int | None = None
    line_processor: int | None = None
    load_processes: int = 0
    load_is: str | None = None
    speed_up: float | None = None
    speed_up_by_processor_time: float | None = None
    records_sha256: str | None = None


class RunFacts(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Course of a run.

    Attributes
    ----------
    ended, reason : str
        How it ended, see `firmware_py.summary.Ended`, and one sentence.
    wall_s : float
        Duration by the wall clock.
    bus_faults : dict of str to int
        Ticks by status of the bus.
    faults_injected : dict of str to int
        Faults of the line by kind.
    telemetry_drops : int
        Ticks that the recorder did not get.
    programme_s : dict of str to float
        Durations of the parts that the run repeats: rest, motion, glide.
    feedback : FeedbackUse
        How often feedback of the tip acted.
    payload_note : str
        Sentence where the estimated payload is beyond those of the plan; else empty.
    """

    ended: str
    reason: str
    wall_s: float
    bus_faults: dict[str, int]
    faults_injected: dict[str, int]
    telemetry_drops: int
    programme_s: dict[str, float]
    feedback: FeedbackUse
    payload_note: str


class TipErrors(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Distance between the predicted and the true tip over some ticks.

    Attributes
    ----------
    n : int
        Ticks with fresh data; the other fields are None where there is none.
    mean_euclidean_distance_m, rms_m, p95_m, max_m : float or None
        Of the distance.
    interval_coverage : float or None
        Fraction of ticks inside the predictor's 95 % interval, mean over the axes that move.
    interval_coverage_least : float or None
        The same on the worst of these axes.
    in_range_fraction : float or None
        Fraction of ticks inside the predictor's training range.
    """

    n: int
    mean_euclidean_distance_m: float | None
    rms_m: float | None
    p95_m: float | None
    max_m: float | None
    interval_coverage: float | None
    interval_coverage_least: float | None
    in_range_fraction: float | None


class PredictionError(TipErrors, frozen=True, kw_only=True):
    """Distance between the predicted and the true tip over a run, and over its parts.

    Attributes
    ----------
    parts : dict of str to TipErrors
        in_range, out_of_range and the parts of the programme, where they have fresh ticks.
    """

    parts: dict[str, TipErrors] = msgspec.field(default_factory=dict)


class PathError(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Distance of the tip from its path in one run of a plan, in the planned coordinates.

    Attributes
    ----------
    rms_m, max_m : float
        Over the whole run, rest and ways included.
    path_rms_m : float
        Over the path alone.
    rows : int
        Ticks that count: fresh, and not of a stop.
    """

    rms_m: float
    max_m: float
    path_rms_m: float
    rows: int


class MoveFigures(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Move of a plan from rest to rest, in the planned coordinates.

    Attributes
    ----------
    settling_s : float
        Time from its start until the tip stays within 10 mm of where it comes to rest.
    swing_m : float
        Half of the largest range of a coordinate after the move itself is over.
    offset_m : float
        Distance of the place of rest from the desired one.
    command_s : float
        Duration of the move itself: of the path, for comparisons of the goals.
    """

    settling_s: float
    swing_m: float
    offset_m: float
    command_s: float


class TimingDocument(TimingVerdict, frozen=True, kw_only=True):
    """Contents of `timing.json`: the verdict, and what it was reached on.

    Attributes
    ----------
    environment : SilEnvironment
        Machine, line and scheduler.
    run : RunFacts
        Course of the run.
    reference_jitter : ReferenceJitter
        Wake-up jitter of the machine, by cyclictest where it is installed, else by the probe.
    probe_jitter : ReferenceJitter or None
        The probe's, where cyclictest gave the reference.
    bus_plan : PlanTimes
        Times that follow from the bus plan.
    account : TickBudget
        Time of the ticks, by where it went.
    prediction_error : PredictionError
        Error of the robot's prediction.
    path_errors : tuple of PathError
        Where a plan was run: error of the tip in each of its runs.
    moves : tuple of MoveFigures
        Moves from rest to rest in the last run of a plan.
    """

    MADE_BY: ClassVar[str] = "python -m hil sil"

    environment: SilEnvironment
    run: RunFacts
    reference_jitter: ReferenceJitter
    probe_jitter: ReferenceJitter | None = None
    bus_plan: PlanTimes
    account: TickBudget
    prediction_error: PredictionError
    path_errors: tuple[PathError, ...] = ()
    moves: tuple[MoveFigures, ...] = ()


def read_timing(path: Path) -> TimingDocument:
    """Read a timing document.

    Raises
    ------
    InputError
        If the file is missing, damaged, or of another version.
    """
    return read_document(path, TimingDocument)


def write_timing(path: Path, document: TimingDocument) -> None:
    """Write a timing document."""
    write_document(path, document)
