"""Summary of a run: end, faults, timing; and the document that holds it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import ClassVar, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import SMALL_CURRENT, signal_unit, signal_words
from firmware_py.documents import Document, read_document, write_document
from firmware_py.realtime.timing import Timing, TimingSummary
from firmware_py.safety.stop_reason import Fault

__all__ = [
    "Ended", "FeedbackUse", "InputBeyond", "RangeReasons", "RunDocument", "RunSummary",
    "read_run_summary", "write_run_summary",
]  # fmt: skip


class Ended(Enum):
    """Kind of end of a run."""

    FINISHED = "finished"
    """The motion, or the requested time, was over."""
    SIGNALLED = "signalled"
    """A signal, like SIGINT; the robot came to a controlled stop."""
    TRIPPED = "tripped"
    """A fault stopped the robot, was seen while it stopped, or a torque was not confirmed off."""


class FeedbackUse(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Use of the feedback of the tip in the motion of a run, approach and stop left out."""

    ticks: int = 0  # Ticks in which feedback was due; 0 where the run has none
    # Those in which it did not act, or faded out, because the estimated tip was not trusted
    lost_ticks: int = 0
    reason: str = ""  # Why trust was lost last; empty where it never was

    @property
    def note(self) -> str:
        """Sentence where feedback was lost; else empty."""
        if not self.lost_ticks:
            return ""
        return (
            f"feedback of the tip was lost in {self.lost_ticks} of {self.ticks} ticks, last "
            f"because {self.reason}"
        )


class InputBeyond(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Measured input that lay beyond its training range in ticks that were out of range."""

    name: str
    unit: str  # SI unit of the values; "1" for none
    ticks: int
    extreme: float  # Value that was furthest beyond
    minimum: float  # Range in the training data
    maximum: float


class RangeReasons(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Why ticks of a run were outside the predictor's training range."""

    # Angles, currents and DI that were beyond their ranges, in the predictor's order
    inputs: tuple[InputBeyond, ...] = ()
    other_ticks: int = 0  # Ticks out of range in which none of them was

    @property
    def note(self) -> str:
        """Continuation of a sentence on how many ticks were out of range; empty without any."""
        told = []
        for row in self.inputs:
            shown = SMALL_CURRENT if row.unit == "A" else signal_unit(row.name)
            low, high = shown.number(row.minimum), shown.text(row.maximum)
            told.append(
                f"{signal_words(row.name)} reached {shown.text(row.extreme)} in {row.ticks} of "
                f"them (trained from {low} to {high})"
            )
        if self.other_ticks:
            told.append(
                f"in {self.other_ticks} of them no angle, current or DI was beyond its trained "
                "range: the prediction interval was too wide, as it is with late samples and with "
                "currents that do not fit the plant"
            )
        return "; ".join(told)


@dataclass(frozen=True)
class RunSummary:
    """Result of a run."""

    ended: Ended
    reason: str  # Cause of the end, one sentence
    ticks: int
    bus_faults: dict[str, int]  # Ticks by status of the bus, OK left out
    out_of_range: int  # Ticks in which the predictor's inputs lay outside its training range
    timing: Timing  # Histograms, misses and their causes
    records: NDArray[np.void]  # (n,), the last ticks, oldest first
    telemetry_drops: int  # Ticks that the recorder did not receive
    replugs: int = 0  # Times that the robot continued after its port had gone
    released: bool = True  # Whether every servo confirmed torque off at the end
    # Kinds of fault that stopped the robot or were seen while it stopped
    faults: frozenset[Fault] = frozenset()
    held_up_ticks: int = 0  # Ticks without fresh data in which the host held up the loop's thread
    # How often feedback of the tip acted
    feedback: FeedbackUse = field(default_factory=FeedbackUse)

    def document(
        self,
        log: Path | None,
        bus_plan: str,
        payload_note: str = "",
        logged_ticks: int | None = None,
        out_of_range_reasons: RangeReasons | None = None,
    ) -> RunDocument:
        """Return everything but the records as a document.

        `bus_plan`: name of the plan by which the servos were read.
        """
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

    ended: Literal["finished", "signalled", "tripped"]
    reason: str
    ticks: int
    bus_faults: dict[str, int]
    out_of_range: int
    telemetry_drops: int
    replugs: int
    released: bool
    timing: TimingSummary
    log: str | None
    bus_plan: str  # Name of the plan by which the servos were read
    held_up_ticks: int = 0
    # Sentence where the currents of the run fit another payload than the told one, or where the
    # estimated payload is beyond those of the plan; else empty
    payload_note: str = ""
    feedback: FeedbackUse = FeedbackUse()
    # Ticks that the log holds; None where there is no log, or the recorder did not say
    logged_ticks: int | None = None
    # Which inputs of the predictor were beyond their ranges in the ticks out of range
    out_of_range_reasons: RangeReasons = RangeReasons()


def read_run_summary(path: Path) -> RunDocument:
    return read_document(path, RunDocument)


def write_run_summary(path: Path, document: RunDocument) -> None:
    write_document(path, document)
