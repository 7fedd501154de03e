"""Rows of the fault table about goals that another program sends."""

from __future__ import annotations

from typing import Final

from hil.faults.fault_row import Expectation, FaultRow, Setup
from hil.faults.injection import FOREVER, Injection

_OUTSIDE: Final = Setup(outside=True)
_GOES_ON: Final = Expectation("finished", lost=0)


def _row(how: str, kind: str, must: Expectation, times: int = FOREVER) -> FaultRow:
    return FaultRow(
        "program that sends the goals", how, must, (Injection(kind, times),), setup=_OUTSIDE
    )


def _stops(reason: str, within: int = 2) -> Expectation:
    return Expectation("tripped", within=within, lost=0, reason=f"sends the goals {reason}")


GOALS: Final = (
    _row("silent for two ticks", "program silent", _GOES_ON, 2),
    _row("silent for good", "program silent", _stops("has sent none for 3 ticks", 4)),
    _row("stuck: it repeats an old answer", "program stuck", _stops("sends goals that are", 6)),
    _row("malformed message", "program malformed", _stops("sends a message that cannot"), 1),
    _row("too fast: a step of 0.2 rad", "program too fast", _stops("moves joint 1 at"), 1),
    _row("tip out of reach", "program out of reach", _stops("wants the tip at"), 1),
    _row("eight messages in a tick", "program flooding", _stops("sends more than 4 goals"), 1),
    _row("program dies", "program gone", _stops("has gone")),
)  # fmt: skip
