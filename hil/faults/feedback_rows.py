"""Rows of the fault table about feedback of the estimated tip: every way in which trust is lost."""

from __future__ import annotations

import math
from typing import Final

from hil.faults.fault_row import Expectation, FaultRow, Setup
from hil.faults.injection import Injection

_TWO_TICKS: Final = 4
"""Exchanges in two ticks whose first reads fail, with their retries."""
_FEEDBACK: Final = Setup(feedback="continue")
_OR_STOP: Final = Setup(feedback="stop")
_NO_TRUST: Final = "the estimated tip is no longer trusted"


def _doubted(fault: str, kind: str, value: float, reason: str) -> list[FaultRow]:
    """Fault of the estimated tip: one tick is ignored; if it lasts, corrections fade, or a stop."""
    once, many = Injection(kind, 1, value), Injection(kind, 30, value)
    gone = Expectation("finished", lost=0, trust="LOST")
    stopped = Expectation("tripped", within=2, reason=f"{_NO_TRUST}: {reason}", trust="LOST")
    return [
        FaultRow(fault, "once", Expectation("finished", lost=0, trust="TRUSTED"), (once,),
            setup=_FEEDBACK),
        FaultRow(fault, "30 ticks, configured to go on", gone, (many,), setup=_FEEDBACK),
        FaultRow(fault, "30 ticks, configured to stop", stopped, (many,), setup=_OR_STOP),
    ]  # fmt: skip


FEEDBACK: Final = (
    *_doubted("innovation of the current too large", "innovation", 2.0, "its innovation is 2.00 A"),
    *_doubted("estimated tip out of range", "range", 0.0, "it is out of range"),
    FaultRow("estimated tip not finite", "two ticks, configured to go on",
        Expectation("finished", lost=0, trust="LOST"), (Injection("predictor", 2, math.nan),),
        setup=_FEEDBACK),
    FaultRow("stale data under feedback", "two ticks, configured to go on",
        Expectation("finished", within=1, lost=2, trust="LOST"),
        (Injection("lost", _TWO_TICKS),), setup=_FEEDBACK),
    FaultRow("stale data under feedback", "two ticks, configured to stop",
        Expectation("tripped", within=1, reason=f"{_NO_TRUST}: the data is stale", trust="LOST"),
        (Injection("lost", _TWO_TICKS),), setup=_OR_STOP),
    FaultRow("host stall of 20 ms under feedback", "once",
        Expectation("finished", within=2, lost=2, trust="TRUSTED"),
        (Injection("stall", 1, 20e-3),), setup=_FEEDBACK),
)  # fmt: skip
