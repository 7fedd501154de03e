"""Summary of a run: end, faults, timing; and its document."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import ClassVar, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.documents import Document
from firmware_py.core.units import LENGTH, SMALL_CURRENT, signal_unit, signal_words
from firmware_py.safety.states import Fault
from firmware_py.system.timing import Timing, TimingSummary


class Ended(Enum):
    FINISHED = "finished"
    """The motion, or the requested time, ended."""
    SIGNALLED = "signalled"
    """A signal such as SIGINT requested a controlled stop."""
    TRIPPED = "tripped"
    """A fault stopped the robot or occurred in the stop, or a torque off was not confirmed."""


class FeedbackUse(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Use of the feedback of the tip during the motion of a run, without approach and stop."""

    ticks: int = 0  # Ticks with feedback switched on; 0 for a run without
    # Ticks in which feedback was off or faded out, because the estimated tip was rejected
    lost_ticks: int = 0
    reason: str = ""  # Reason of the latest loss of trust; empty without one

    @property
    def note(self) -> str:
        """Sentence about a loss of feedback; empty without one."""
        if not self.lost_ticks:
            return ""
        return (
            f"feedback of the tip was lost in {self.lost_ticks} of {self.ticks} ticks, last "
            f"because {self.reason}"
        )


class InputBeyond(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Input of the predictor that was beyond the range that it accepts."""

    name: str
    unit: str  # SI unit of the values; "1" for none
    ticks: int  # Number of ticks beyond the range
    extreme: float  # Value farthest beyond the range
    minimum: float  # Lower end of the range in the training data
    maximum: float  # Upper end of the range in the training data


class RangeReasons(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Reasons why ticks of a run were out of range."""

    # Inputs of the predictor beyond their ranges, in its order. Angles, currents and DI always;
    # of the observer's signals those that the loop gets
    inputs: tuple[InputBeyond, ...] = ()
    wide_ticks: int = 0  # Ticks with none of them beyond, but too wide an interval
    late_ticks: int = 0  # Those of them whose sample was an old one
    widest_m: float = 0.0  # Largest half width in these ticks
    other_ticks: int = 0  # Ticks out of range with neither: another signal of the observer, or NaN

    @property
    def note(self) -> str:
        """Continuation of a sentence about the ticks out of range; empty without reasons."""
        causes = []
        for row in self.inputs:
            shown = SMALL_CURRENT if row.unit == "A" else signal_unit(row.name)
            low, high = shown.number(row.minimum), shown.text(row.maximum)
            causes.append(
                f"{signal_words(row.name)} reached {shown.text(row.extreme)} in {row.ticks} of "
                f"them (trained from {low} to {high})"
            )
        if self.wide_ticks:
            late = f", in {self.late_ticks} because the sample was late" if self.late_ticks else ""
            causes.append(
                f"the interval was up to ±{LENGTH.text(self.widest_m)} in {self.wide_ticks} of "
                f"them{late}: a large bend, or currents that the plant explains less well"
            )
        if self.other_ticks:
            causes.append(
                f"in {self.other_ticks} of them another signal of the observer (bend, rates, "
                "payload, tip) was beyond its range, or one was not a number"
            )
        return "; ".join(causes)


@dataclass(frozen=True)
class RunSummary:
    ended: Ended
    reason: str  # Cause of the end, as a sentence
    ticks: int
    bus_faults: dict[str, int]  # Number of ticks by bus status, without OK
    out_of_range: int  # Ticks with an input of the predictor outside its training range
    timing: Timing  # Histograms, misses and their causes
    records: NDArray[np.void]  # (n,), the last ticks, oldest first
    telemetry_drops: int  # Ticks that the recorder did not receive
    replugs: int = 0  # Number of restarts after a disconnect of the port
    released: bool = True  # Whether every servo confirmed torque off at the end
    # Kinds of fault that stopped the robot or occurred while it stopped
    faults: frozenset[Fault] = frozenset()
    held_up_ticks: int = 0  # Ticks without fresh data because the host delayed the loop's thread
    feedback: FeedbackUse = field(default_factory=FeedbackUse)

    def document(
        self,
        log: Path | None,
        bus_plan: str,
        payload_note: str = "",
        logged_ticks: int | None = None,
        out_of_range_reasons: RangeReasons | None = None,
    ) -> RunDocument:
        return RunDocument(
            schema=RunDocument.VERSION, ended=self.ended.value, reason=self.reason,
            ticks=self.ticks, bus_faults=self.bus_faults, out_of_range=self.out_of_range,
            telemetry_drops=self.telemetry_drops, replugs=self.replugs, released=self.released,
            timing=self.timing.summary(), log=str(log) if log else None, bus_plan=bus_plan,
            held_up_ticks=self.held_up_ticks, payload_note=payload_note, feedback=self.feedback,
            logged_ticks=logged_ticks, out_of_range_reasons=out_of_range_reasons or RangeReasons(),
        )  # fmt: skip


class RunDocument(Document, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Summary of a run as `dropstitch run` writes it beside the log, `NAME.timing.json`."""

    MADE_BY: ClassVar[str] = "dropstitch run"

    # "finished": the motion or the requested time ended; "signalled": a signal stopped the robot;
    # "tripped": a fault
    ended: Literal["finished", "signalled", "tripped"]
    reason: str  # Cause of the end, as a sentence
    ticks: int  # Number of ticks
    bus_faults: dict[str, int]  # Number of ticks by bus status, without OK
    out_of_range: int  # Ticks with an input of the predictor outside its training range
    telemetry_drops: int  # Ticks that the recorder did not receive
    replugs: int  # Number of restarts after a disconnect of the port
    released: bool  # Whether every servo confirmed torque off at the end
    timing: TimingSummary
    log: str | None  # File of the log; null without one
    bus_plan: str  # Name of the plan for reading the servos
    held_up_ticks: int = 0  # Ticks without fresh data because the host delayed the loop's thread
    # Sentence if the currents contradict the payload of robot.toml, or if the estimated payload is
    # beyond those of the plan; else empty
    payload_note: str = ""
    feedback: FeedbackUse = FeedbackUse()
    # Ticks in the log; null without a log, or if the recorder did not report them
    logged_ticks: int | None = None
    # Inputs of the predictor that were beyond their ranges
    out_of_range_reasons: RangeReasons = RangeReasons()
